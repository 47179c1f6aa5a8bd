// The page that stays open: where we are, whether the data are fit, and why.

import { get, lease, may } from "./api.js";
import { abortRun, acknowledgeCondition, acknowledgeFault, giveCommand, startRun, takeCommand } from "./commands.js";
import { card, duration, figures, fill, h, refill, said, table, utc } from "./dom.js";
import { conditionWords, i18n, stateName, t } from "./i18n.js";
import { live, SILENT_MS } from "./live.js";
import { colour, draw } from "./plots.js";

const MG = 9.80665e-3;
const DEG_H = Math.PI / 180 / 3600;
const CHANNELS = ["x", "y", "z"].flatMap((axis, i) => [["accel", axis, i]]).concat(["x", "y", "z"].map((axis, i) => ["gyro", axis, i]));
const SIGNS = {
  good: ["M50 4a46 46 0 1 0 .1 0z", "M28 52l15 15 30-34"],
  bad: ["M31 4h38l27 27v38L69 96H31L4 69V31z", "M33 33l34 34M67 33L33 67"],
  warn: ["M50 8L96 90H4z", "M50 36v26M50 74v4"],
  busy: ["M50 4a46 46 0 1 0 .1 0z", "M50 24v28l18 12"],
};
const MARKS = { ok: "✓", failed: "✕", pending: "…", acknowledged: "!", unknown: "?" };

export function liveView(main) {
  const place = {
    verdict: h("section", { "aria-live": "polite" }),
    path: h("div"), command: h("div"), conditions: h("div"), plots: h("div", { class: "plots" }),
    terms: h("div"), navigation: h("div"), line: h("div"), log: h("div", { class: "log", tabindex: "0", role: "region", "aria-label": t("log") }),
  };
  fill(
    main,
    h("h1", { class: "hidden" }, t("live")),
    h(
      "div",
      { class: "grid" },
      h("div", { class: "two-thirds grid" }, place.verdict, card(t("path"), place.path)),
      h("div", { class: "third grid" }, card(t("command"), place.command), card(t("line"), place.line)),
      h("div", { class: "half grid" }, card(t("conditions"), place.conditions), card(t("navigation_error"), place.navigation)),
      h("div", { class: "half grid" }, card(t("terms"), place.terms)),
      card(t("sensors"), place.plots),
      card(t("log"), place.log),
    ),
  );
  const plots = makePlots(place.plots);
  const shown = { conditions: [], plan: null, run: null, runKey: "", counters: null };
  const failing = (error) => error.status === undefined && console.warn(error);

  async function slow() {
    try {
      const [conditions, line] = await Promise.all([get("/conditions"), get("/line")]);
      shown.conditions = conditions.conditions;
      shown.counters = line;
      if (!shown.plan) shown.plan = await get("/plan");
      await readRun();
    } catch (error) {
      failing(error);
    }
    paint();
  }

  async function readRun() {
    const status = live.status;
    if (!status || !status.run_id) return;
    const over = ["READY", "HOLD", "FAULT", "ABORTED", "OFFLINE"].includes(status.state);
    const key = `${status.run_id} ${status.state} ${status.reason}`;
    if (over && key === shown.runKey) return;
    const detail = await get(`/runs/${status.run_id}`);
    if (!over && JSON.stringify(detail.terms) === shown.runKey) return;
    let result = null;
    let navigation = null;
    if (over) {
      result = await get(`/runs/${status.run_id}/result`).catch(() => null);
      if (result) navigation = await get(`/runs/${status.run_id}/navigation`).catch(() => null);
    }
    shown.run = { detail, result, navigation, state: status.state };
    shown.runKey = over ? key : JSON.stringify(detail.terms);
    drawTerms(place.terms, shown);
    drawNavigation(place.navigation, shown);
  }

  function paint() {
    const status = live.status;
    const stale = live.stale;
    main.classList.toggle("gone", stale !== null);
    paintVerdict(place.verdict, status, stale);
    if (!status) return;
    paintPath(place.path, status, shown.plan);
    paintCommand(place.command, status, stale);
    // What a silent service said of its conditions holds no longer.
    paintConditions(place.conditions, stale === "silent" ? shown.conditions.map((one) => ({ ...one, state: "unknown" })) : shown.conditions);
    paintLine(place.line, status, shown.counters, stale);
    refill(place.log, [live.log.length, live.log[0], i18n.language], () => paintLog(live.log));
  }

  fill(place.terms, h("p", { class: "dim" }, t("no_terms")));
  fill(place.navigation, h("p", { class: "dim" }, t("no_result")));
  fillLog();
  const onChange = () => paint();
  const onCondition = () => slow();
  live.addEventListener("change", onChange);
  live.addEventListener("condition", onCondition);
  live.addEventListener("state", onCondition);
  live.addEventListener("status", onCondition);
  const slowly = setInterval(slow, 1000);
  const drawing = setInterval(() => drawPlots(plots, live.samples), 1000);
  slow();
  paint();
  return () => {
    live.removeEventListener("change", onChange);
    for (const kind of ["condition", "state", "status"]) live.removeEventListener(kind, onCondition);
    clearInterval(slowly);
    clearInterval(drawing);
  };
}

// What happened before the page was opened stands in the record of the newest run.
async function fillLog() {
  if (live.log.length) return;
  const list = await get("/runs?limit=1").catch(() => null);
  if (!list || !list.runs.length || live.log.length) return;
  const run = await get(`/runs/${list.runs[0].run_id}`).catch(() => null);
  if (!run) return;
  for (const one of run.transitions) live.note(one.utc, `${one.source} → ${one.target}`, one.detail ? `${one.reason}: ${one.detail}` : one.reason);
}

export function judge(status, stale) {
  if (stale || !status) return { kind: "warn", word: t("stale"), sub: stale === "line" ? t("stale_line") : t("stale_silent") };
  const sub = stateName(status.state);
  if (status.fit) return { kind: "good", word: t("fit"), sub: `${sub} · ${t("fit_text")}` };
  if (status.state === "FAULT") return { kind: "bad", word: t("fault"), sub: t("not_fit_text") };
  if (status.state === "HOLD") return { kind: "bad", word: t("held"), sub: t("not_fit_text") };
  if (["OFFLINE", "ABORTED"].includes(status.state)) return { kind: "bad", word: t("no_run"), sub: `${sub} · ${t("not_fit_text")}` };
  if (status.state === "READY") return { kind: "bad", word: t("not_fit"), sub: `${sub} · ${t("not_fit_text")}` };
  return { kind: "busy", word: t("working"), sub: `${sub} · ${t("not_fit_text")}` };
}

function sign(kind) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 100 100");
  svg.setAttribute("class", "sign");
  svg.setAttribute("aria-hidden", "true");
  for (const [i, d] of SIGNS[kind].entries()) {
    const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
    for (const [name, value] of Object.entries({ d, fill: "none", stroke: "currentColor", "stroke-width": i ? 9 : 6, "stroke-linecap": "round", "stroke-linejoin": "round" })) path.setAttribute(name, value);
    svg.append(path);
  }
  return svg;
}

function paintVerdict(place, status, stale) {
  const found = judge(status, stale);
  const reasons = stale === "silent" || !status ? [] : status.reasons;
  place.className = `card verdict ${found.kind}`;
  place.dataset.verdict = found.kind;
  refill(place, [found, reasons], () => [
    sign(found.kind),
    h("div", {}, h("h2", { class: "hidden" }, t("verdict")), h("div", { class: "word" }, found.word), h("div", { class: "sub" }, found.sub)),
    reasons.length ? h("ul", { "aria-label": t("reasons") }, reasons.map((one) => h("li", {}, said(one)))) : null,
  ]);
}

function paintPath(place, status, plan) {
  const steps = plan ? plan.steps : [];
  const names = steps.map((one) => one.step);
  const at = names.indexOf(status.stage || status.state);
  const held = status.state === "HOLD";
  const later = steps.slice(at + 1).reduce((sum, one) => sum + (one.at_least_s || 0), 0);
  const own = status.remaining_s ?? 0;
  const busy = at >= 0 && !held && status.state !== "READY";
  const facts = [names, at, held, status.state, i18n.language];
  if (!place.firstChild || place.dataset.facts !== JSON.stringify(facts)) {
    place.dataset.facts = JSON.stringify(facts);
    fill(
      place,
      h("ol", { class: "path" }, steps.map((one, i) => {
        const kind = i < at || (i === at && status.state === "READY") ? "done" : i === at ? (held ? "held" : "now") : "next";
        const mark = { done: "✓", now: "▶", held: "‖", next: "○" }[kind];
        return h("li", { class: kind, "aria-current": i === at ? "step" : null }, h("b", { "aria-hidden": "true" }, mark), h("span", {}, stateName(one.step)));
      })),
      h("div", { class: "stage" }, h("strong"), h("span", { class: "time" })),
      h("progress", { max: "1", "aria-label": t("path") }),
      h("p", { class: "dim" }),
    );
  }
  const [stage, bar, line] = [place.querySelector(".stage"), place.querySelector("progress"), place.querySelector("p")];
  stage.firstChild.textContent = at >= 0 ? `${t("step_of", { n: at + 1, all: steps.length })}: ${stateName(status.state)}` : stateName(status.state);
  stage.lastChild.textContent = busy ? (status.remaining_s === null ? t("deciding") : t("remaining", { time: duration(status.remaining_s) })) : "";
  if (status.progress === null) bar.value = 0;
  else bar.value = status.progress;
  const following = at >= 0 && at + 1 < names.length ? t("next", { step: stateName(names[at + 1]) }) : "";
  line.textContent = busy ? `${following} · ${t("at_least", { time: duration(own + later) })}` : "";
}

function paintCommand(place, status, stale) {
  const allowed = may("operator") ? status.allowed : [];
  const facts = [allowed, status.run_id, lease.id, lease.holder, Math.ceil((lease.left_s || 0) / 5), i18n.language, may("operator"), status.state === "FAULT" ? status.reasons : 0, stale];
  refill(place, facts, () => {
    const mine = lease.id !== null;
    const words = mine ? t("command_mine") : lease.holder ? t("command_held", { holder: lease.holder, s: Math.ceil(lease.left_s) }) : t("command_free");
    const locked = lease.holder !== null && !mine;
    const button = (name, label, kind, act) => h("button", { class: kind, disabled: !allowed.includes(name) || locked, onclick: act, "data-command": name }, label);
    return [
      h(
        "div",
        { class: "buttons" },
        button("start", t("start"), "primary", startRun),
        button("abort", t("abort"), "danger", () => abortRun(status.run_id)),
        status.state === "FAULT" ? button("acknowledge", t("acknowledge_fault"), "", () => acknowledgeFault(status.run_id, status.reasons.join("; "))) : null,
      ),
      h("p", { class: "dim" }, words),
      may("operator")
        ? h("div", { class: "buttons" }, mine ? h("button", { class: "quiet", onclick: giveCommand }, t("give")) : h("button", { class: "quiet", onclick: takeCommand }, lease.holder ? t("take_over") : t("take")))
        : null,
    ];
  });
}

function paintConditions(place, conditions) {
  const facts = [conditions.map((one) => [one.name, one.state, one.text, one.acknowledgement]), i18n.language, may("operator")];
  const open = new Set([...place.querySelectorAll("details[open]")].map((one) => one.dataset.name));
  const focused = document.activeElement?.closest?.("details")?.dataset.name;
  refill(place, facts, () =>
    h("ul", { class: "conditions" }, conditions.map((one) => {
      const words = conditionWords(one);
      const tell = (text) => (words.own ? h("span", {}, text) : said(text));
      return h(
        "li",
        { class: one.state },
        h(
          "details",
          { "data-name": one.name, open: open.has(one.name) },
          h("summary", {}, h("span", { class: "mark", "aria-hidden": "true" }, MARKS[one.state]), tell(words.title), h("span", { class: "value" }, t(one.state), one.state === "ok" || one.state === "unknown" || one.measured === null ? null : [" · ", said(measured(one))])),
          h(
            "dl",
            {},
            h("dt", {}, t("measured")), h("dd", {}, said(one.text)),
            h("dt", {}, t("since")), h("dd", {}, said(utc(one.since))),
            h("dt", {}, t("severity")), h("dd", {}, t(one.severity)),
            h("dt", {}, t("cause")), h("dd", {}, tell(words.cause)),
            h("dt", {}, t("remedy")), h("dd", {}, tell(words.remedy)),
            one.acknowledgement ? [h("dt", {}, t("acknowledged_by")), h("dd", {}, said(`${one.acknowledgement.by}: ${one.acknowledgement.reason} (${utc(one.acknowledgement.utc)})`))] : null,
          ),
          one.state === "failed" && may("operator") ? h("p", {}, h("button", { onclick: () => acknowledgeCondition(one.name, words.title) }, t("acknowledge"))) : null,
        ),
      );
    })),
  );
  if (focused) place.querySelector(`details[data-name="${focused}"] summary`)?.focus();
}

function measured(one) {
  return one.limit === null ? `${figures(one.measured)} ${one.unit}` : `${figures(one.measured)} / ${figures(one.limit)} ${one.unit}`;
}

function paintLine(place, status, line, stale) {
  const counts = line ? Object.entries(line.counters).filter(([, count]) => count > 0) : [];
  const age = live.silentMs > SILENT_MS ? `${t("silent_for", { s: (live.silentMs / 1000).toFixed(1) })}` : status.age_s === null ? "–" : `\u2066${status.age_s.toFixed(2)} s\u2069`;
  refill(place, [status.link, age, counts, stale, i18n.language], () => [
    h(
      "dl",
      {},
      h("dt", {}, t("state")), h("dd", {}, h("span", { class: `tag ${stale ? "warn" : status.link === "STREAMING" ? "good" : "bad"}` }, stale ? `⚠ ${t("stale")}` : status.link)),
      h("dt", {}, t("age")), h("dd", { class: "number" }, age),
    ),
    h("details", {}, h("summary", {}, t("counters")), h("dl", { dir: "ltr", lang: "en" }, counts.map(([name, count]) => [h("dt", {}, name.replaceAll("_", " ")), h("dd", { class: "number" }, String(count))]))),
  ]);
}

function paintLog(entries) {
  if (!entries.length) return h("p", { class: "dim" }, t("none"));
  return table([t("when"), t("what"), t("why")], entries.slice(0, 60).map((one) => [h("time", { datetime: one.utc, title: utc(one.utc), lang: "en", dir: "ltr" }, utc(one.utc).slice(11)), said(one.what), said(one.why)]), t("log"));
}

function makePlots(place) {
  const names = [...CHANNELS, ["temperature", "", 0]];
  const made = names.map(([kind, axis, index]) => {
    const value = h("b", { dir: "ltr" }, "–");
    const plot = h("div", { class: "plot" });
    const label = `${t(kind)} ${axis}`.trim();
    return { kind, index, value, plot, figure: h("figure", { role: "group", "aria-label": label }, h("figcaption", {}, h("span", {}, label), value), plot) };
  });
  fill(place, made.map((one) => one.figure));
  return made;
}

const UNITS = { accel: ["m/s²", 1, 4], gyro: ["deg/h", 1 / DEG_H, 1], temperature: ["°C", 1, 2] };

function drawPlots(plots, samples) {
  if (!samples.length || document.hidden) return;
  const newestS = samples[samples.length - 1].time_s;
  const time = samples.map((one) => one.time_s - newestS);
  for (const { kind, index, value, plot } of plots) {
    const [unit, scale, digits] = UNITS[kind];
    const of = (name) => samples.map((one) => (kind === "temperature" ? one.temperature_c[0] : one[kind === "accel" ? "accel_mps2" : "gyro_radps"][name][index] * scale));
    const mean = of("mean");
    const newest = mean[mean.length - 1];
    value.textContent = newest === null || newest === undefined ? "–" : `${newest.toFixed(digits)} ${unit}`;
    const line = (y, more) => ({ x: time, y, mode: "lines", hoverinfo: "skip", line: { width: 0, color: colour("blue") }, ...more });
    const traces = kind === "temperature" ? [] : [line(of("low"), {}), line(of("high"), { fill: "tonexty", fillcolor: `${colour("blue")}40` })];
    traces.push(line(mean, { line: { width: 2, color: colour("blue") } }));
    draw(plot, traces, { margin: { l: 52, r: 6, t: 4, b: 22 }, xaxis: { nticks: 4, ticksuffix: " s" }, yaxis: { nticks: 4 } });
  }
}

export function faceTerms(terms) {
  return [...terms.f_mps2.map((one) => one / MG), ...terms.g_radps.map((one) => one / DEG_H)];
}

export function faceSigma(sigma) {
  return [...sigma.f_mps2.map((one) => (one === null ? null : one / MG)), ...sigma.g_radps.map((one) => (one === null ? null : one / DEG_H))];
}

function drawTerms(place, { run, plan }) {
  const stages = run.result ? run.result.terms : run.detail.terms;
  const names = ["stage_1", "stage_2", "stage_3"].filter((name) => stages[name]);
  if (!names.length) {
    fill(place, h("p", { class: "dim" }, t("no_terms")));
    return;
  }
  const sigma = run.result ? faceSigma(run.result.sigma) : Array(6).fill(null);
  const shades = ["55", "99", "ff"];
  const bars = (first, unit, most) => {
    const plot = h("div", { class: "plot tall", role: "img", "aria-label": `${t("terms")}, ${unit}` });
    const axes = ["x", "y", "z"];
    const traces = names.map((name, i) => {
      const last = i === names.length - 1;
      const spread = sigma.slice(first, first + 3).map((one) => one ?? 0);
      return { type: "bar", x: axes, y: faceTerms(stages[name]).slice(first, first + 3), name: `${t("stage")} ${i + 1}`, marker: { color: `${colour("blue")}${shades[i]}`, line: { color: colour("blue"), width: 1 } }, error_y: last && run.result ? { type: "data", array: spread, color: colour("ink"), thickness: 2, width: 5 } : undefined };
    });
    const band = { type: "rect", xref: "paper", x0: 0, x1: 1, y0: -most, y1: most, fillcolor: `${colour("good")}22`, line: { width: 1, dash: "dot", color: colour("good") }, layer: "below" };
    requestAnimationFrame(() => draw(plot, traces, { barmode: "group", shapes: [band], showlegend: true, legend: { orientation: "h", y: -0.15 }, yaxis: { title: { text: `${first ? t("gyro") : t("accel")}, ${unit}` } }, margin: { l: 60, r: 8, t: 8, b: 48 } }));
    return plot;
  };
  const rows = ["accel x", "accel y", "accel z", "gyro x", "gyro y", "gyro z"].map((label, i) => {
    const [kind, axis] = label.split(" ");
    const cells = names.map((name) => said(`${faceTerms(stages[name])[i] >= 0 ? "+" : "−"}${Math.abs(faceTerms(stages[name])[i]).toFixed(4)}`));
    return [`${t(kind)} ${axis}, ${i < 3 ? "mg" : "deg/h"}`, ...cells, said(sigma[i] === null ? "–" : sigma[i].toFixed(4))];
  });
  const limits = plan || { accel_term_mg: 1, gyro_term_dph: 10 };
  fill(
    place,
    h("p", { class: "dim" }, t("terms_text", { accel: limits.accel_term_mg, gyro: limits.gyro_term_dph })),
    bars(0, "mg", limits.accel_term_mg),
    bars(3, "deg/h", limits.gyro_term_dph),
    table([t("sensor"), ...names.map((_, i) => `${t("stage")} ${i + 1}`), t("sigma")], rows, t("terms")),
  );
}

function drawNavigation(place, { run }) {
  const facts = run.navigation;
  if (!facts) {
    fill(place, h("p", { class: "dim" }, t("no_result")));
    return;
  }
  const last = facts.time_s.length - 1;
  const words = t("navigation_text", { t: facts.time_s[last], without: figures(facts.without_m[last], 3), with: figures(facts.with_50_m[last], 3), with95: figures(facts.with_95_m[last], 3) });
  const plot = h("div", { class: "plot tall", role: "img", "aria-label": words });
  const line = (y, name, name_colour, dash) => ({ x: facts.time_s, y, name, mode: "lines", line: { width: 3, color: colour(name_colour), dash } });
  fill(place, h("p", {}, words), plot);
  requestAnimationFrame(() =>
    draw(plot, [line(facts.without_m, t("without"), "bad", "dash"), line(facts.with_95_m, t("with_95"), "good", "dot"), line(facts.with_50_m, t("with_50"), "good", "solid")], {
      showlegend: true, legend: { orientation: "h", y: -0.16 }, yaxis: { type: "log", title: { text: "m" }, dtick: 1 }, xaxis: { ticksuffix: " s" }, margin: { l: 60, r: 8, t: 8, b: 60 },
    }),
  );
}
