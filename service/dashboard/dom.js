// Elements from plain calls: h("p", {class: "dim"}, "text", child). Text is only ever set as text.

export function h(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key === "style") for (const [one, size] of Object.entries(value)) made.style.setProperty(one, size);
    else made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.flat(3).filter((one) => one !== null && one !== undefined && one !== false));
  return made;
}

// Words of the service (reasons, names, ids) are English and read from left to right, whatever the page's language.
export const said = (text, name = "span") => h(name, { lang: "en", dir: "ltr", class: "said" }, text);

export const fill = (place, ...children) => place.replaceChildren(...children.flat(3).filter(Boolean));

// Fills a place only when what it shows has changed, so that focus and selection stay where they are.
export function refill(place, facts, make) {
  const text = JSON.stringify(facts);
  if (place.dataset.shown === text) return;
  place.dataset.shown = text;
  fill(place, make());
}

export function card(title, ...children) {
  return h("section", { class: "card" }, h("h2", {}, title), ...children);
}

export function table(head, rows, caption) {
  return h(
    "div",
    { class: "wide", tabindex: "0", role: "region", "aria-label": caption },
    h(
      "table",
      {},
      h("thead", {}, h("tr", {}, head.map((one) => h("th", { scope: "col" }, one)))),
      h("tbody", {}, rows.map((row) => h("tr", {}, row.map((cell) => h("td", {}, cell))))),
    ),
  );
}

export const utc = (text) => (text ? text.replace("T", " ").replace(/\.\d+/, "").replace("Z", " UTC") : "–");

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const whole = Math.max(0, Math.round(seconds));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

export function figures(value, digits = 4) {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number") return String(value);
  return Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3) ? value.toExponential(2) : String(Number(value.toPrecision(digits)));
}
