// The page: who is asking, which view is shown, in which language and light.

import { call, get, lease, may, readSession, session, watchLease } from "./api.js";
import { tell } from "./dialogs.js";
import { fill, h, said } from "./dom.js";
import { i18n, speak, t } from "./i18n.js";
import { live } from "./live.js";
import { ageingView } from "./view_ageing.js";
import { discrepanciesView } from "./view_discrepancies.js";
import { libraryView } from "./view_library.js";
import { liveView } from "./view_live.js";
import { compareView, runsView, runView } from "./view_runs.js";

const main = document.getElementById("main");
const PAGES = [["live", "#/"], ["runs", "#/runs"], ["compare", "#/compare"], ["library", "#/library"], ["discrepancies", "#/discrepancies"], ["ageing", "#/ageing"]];
const VIEWS = { "": liveView, runs: runsView, run: runView, compare: compareView, library: libraryView, discrepancies: discrepanciesView, ageing: ageingView };
const THEMES = ["auto", "light", "dark"];
let leave = null;
let turn = 0;

function theme() {
  const wanted = localStorage.getItem("inertrim.theme") || "auto";
  const dark = wanted === "dark" || (wanted === "auto" && matchMedia("(prefers-color-scheme: dark)").matches);
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  return wanted;
}

function nextTheme() {
  localStorage.setItem("inertrim.theme", THEMES[(THEMES.indexOf(theme()) + 1) % THEMES.length]);
  show();
}

function header() {
  const here = location.hash.split("/")[1] || "";
  const current = { run: "runs", "": "live" }[here] ?? here;
  fill(
    document.getElementById("top"),
    h(
      "div",
      { class: "bar" },
      h("a", { class: "brand", href: "#/", style: { color: "inherit", "text-decoration": "none" } }, h("img", { src: "/dashboard/icon.svg", alt: "" }), said("inertrim")),
      h("nav", { "aria-label": t("navigation") }, PAGES.map(([name, link]) => h("a", { href: link, "aria-current": name === current ? "page" : null }, t(name)))),
      h(
        "div",
        { class: "tools" },
        session.needed && session.name ? h("span", { class: "dim" }, said(`${session.name} (${session.role})`)) : null,
        session.needed && session.csrf ? h("button", { onclick: signOut }, t("sign_out")) : null,
        h("button", { onclick: nextTheme, id: "theme" }, `${t("theme")}: ${t(`theme_${theme()}`)}`),
        h("button", { onclick: () => { speak(i18n.language === "en" ? "fa" : "en"); show(); }, id: "language", lang: i18n.language === "en" ? "fa" : "en" }, i18n.language === "en" ? "فارسی" : "English"),
      ),
    ),
  );
}

async function show() {
  const mine = ++turn;
  if (leave) leave();
  leave = null;
  theme();
  header();
  document.title = `inertrim · ${t(PAGES.find(([, link]) => link === (location.hash || "#/"))?.[0] ?? "run")}`;
  if (session.needed && !session.name) {
    signIn();
    return;
  }
  const [, name = "", ...rest] = (location.hash || "#/").split("/").map(decodeURIComponent);
  try {
    const left = await (VIEWS[name] || liveView)(main, ...rest);
    if (mine === turn) leave = left || null;
    else if (left) left();
  } catch (error) {
    if (mine === turn) fill(main, h("section", { class: "card" }, h("h1", {}, t("page_failed", { why: "" })), h("p", {}, said(error.message))));
  }
}

function signIn() {
  const input = h("input", { type: "password", name: "token", required: true, autocomplete: "off", dir: "ltr", id: "token" });
  fill(
    main,
    h(
      "form",
      {
        class: "card",
        onsubmit: async (event) => {
          event.preventDefault();
          try {
            Object.assign(session, await call("POST", "/session", { token: input.value.trim() }));
            live.start();
            show();
          } catch (error) {
            tell(error.message, true);
          }
        },
      },
      h("h1", {}, t("sign_in")),
      h("p", {}, t("sign_in_text")),
      h("label", { class: "field", for: "token" }, h("span", {}, t("token"))),
      input,
      h("div", { class: "buttons" }, h("button", { class: "primary", type: "submit" }, t("sign_in"))),
    ),
  );
}

async function signOut() {
  await call("DELETE", "/session").catch(() => null);
  Object.assign(session, { name: null, role: null, csrf: null });
  live.stop();
  show();
}

function warn() {
  const signedIn = !session.needed || session.name;
  const stale = signedIn ? live.stale : null;
  const place = document.getElementById("stale");
  const text = stale === null ? "" : `⚠ ${t("stale")} — ${t(stale === "line" ? "stale_line" : "stale_silent")}`;
  if (place.textContent !== text) place.textContent = text;
}

window.addEventListener("hashchange", () => { main.focus(); show(); });
window.addEventListener("signed-out", () => { if (session.name) { session.name = null; live.stop(); show(); } });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => show());
live.addEventListener("change", warn);
live.addEventListener("lease", () => watchLease().catch(() => null));
setInterval(() => { if (may("viewer")) watchLease().catch(() => null); }, 5000);

speak(i18n.language);
theme();
try {
  await readSession();
} catch {
  // The service does not answer: the page says so as it says it later, by silence.
}
if (!session.needed || session.name) {
  live.start();
  watchLease().catch(() => null);
}
show();
