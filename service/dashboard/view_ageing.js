// How blocks age: what every block's terms have done since its calibration, and when it will leave its limit.

import { get } from "./api.js";
import { card, fill, h, said, table } from "./dom.js";
import { t } from "./i18n.js";
import { colour, draw } from "./plots.js";

const SCALES = { f: ["mg", 9.80665e-3], g: ["deg/h", Math.PI / 180 / 3600] };

export async function ageingView(main) {
  let facts;
  try {
    facts = await get("/ageing");
  } catch (error) {
    if (error.status !== 404) throw error;
    fill(main, h("h1", {}, t("ageing")), h("section", { class: "card" }, h("p", { class: "dim" }, t("not_there"))));
    return;
  }
  const blocks = Object.entries(facts.blocks);
  const detail = h("div", { class: "grid" });
  const rows = blocks.map(([name, block]) => [
    h("button", { onclick: () => show(detail, name) }, said(name)),
    said(String(block.checks)),
    said(block.last_date || `${block.last_months} months`),
    said(leaving(block.leaves_limit)),
    block.attention.length ? h("span", { class: "tag bad" }, "✕ ", said(block.attention.join("; "))) : h("span", { class: "tag good" }, "✓"),
  ]);
  fill(
    main,
    h("h1", {}, t("ageing")),
    h("p", { class: "dim" }, t("ageing_text")),
    h("div", { class: "grid" }, h("section", { class: "card" }, rows.length ? table([t("block"), t("checks"), t("last_check"), t("leaves"), t("attention")], rows, t("ageing")) : h("p", { class: "dim" }, t("none")))),
    detail,
  );
  if (blocks.length) await show(detail, blocks[0][0]);
}

function leaving(found) {
  if (found.median_date) return `${found.median_date} (${found.low_date} … ${found.high_date || "–"})`;
  if (found.median_months !== null && found.median_months !== undefined) return `${found.median_months.toFixed(0)} months`;
  return `> ${(100 * found.beyond_horizon).toFixed(0)} %`;
}

async function show(place, name) {
  const facts = await get(`/ageing?block=${encodeURIComponent(name)}`);
  const block = facts.blocks[name];
  const cards = Object.entries(block.terms).map(([term, curve]) => {
    const [unit, scale] = SCALES[term[0]];
    const plot = h("div", { class: "plot tall", role: "img", "aria-label": `${name} ${term}` });
    const of = (list) => list.map((one) => one / scale);
    const forecast = curve.forecast;
    const edge = (sign) => forecast.mean.map((one, i) => (one + sign * 1.645 * forecast.sigma[i]) / scale);
    const limit = facts.limits.by_term[term] / scale;
    const line = (y) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: y, y1: y, line: { color: colour("bad"), dash: "dash", width: 2 } });
    requestAnimationFrame(() =>
      draw(plot, [
        { x: forecast.months, y: edge(-1), mode: "lines", line: { width: 0 } },
        { x: forecast.months, y: edge(1), mode: "lines", line: { width: 0 }, fill: "tonexty", fillcolor: `${colour("blue")}40` },
        { x: forecast.months, y: of(forecast.mean), mode: "lines", line: { color: colour("blue"), width: 2 } },
        { x: curve.history.months, y: of(curve.history.value), mode: "markers", marker: { color: colour("ink"), size: 6 }, error_y: { type: "data", array: of(curve.history.sigma), color: colour("ink") } },
      ], { shapes: [line(limit), line(-limit)], yaxis: { title: { text: unit } }, xaxis: { title: { text: t("months") } }, margin: { l: 60, r: 8, t: 8, b: 44 } }),
    );
    return h("figure", { class: "half" }, h("figcaption", {}, h("span", {}, said(`${name} · ${term}`)), h("b", {}, unit)), plot);
  });
  fill(place, card(name, h("div", { class: "grid" }, cards)));
}
