// Runs: the list, one run, and two side by side.

import { get } from "./api.js";
import { card, figures, fill, h, said, table, utc } from "./dom.js";
import { stateName, t } from "./i18n.js";
import { faceSigma, faceTerms } from "./view_live.js";

const SENSORS = [["accel", "x", "mg"], ["accel", "y", "mg"], ["accel", "z", "mg"], ["gyro", "x", "deg/h"], ["gyro", "y", "deg/h"], ["gyro", "z", "deg/h"]];

function verdictTag(run) {
  const kind = run.verdict === null ? (run.ended ? "bad" : "busy") : run.verdict === "not fit" ? "bad" : "good";
  const mark = { good: "✓", bad: "✕", busy: "▶" }[kind];
  return h("span", { class: `tag ${kind}` }, `${mark} `, run.verdict === null ? stateName(run.state) : said(run.verdict));
}

export function runsView(main) {
  const rows = [];
  const list = h("div");
  const more = h("div", { class: "buttons" });
  fill(main, h("h1", {}, t("runs")), h("div", { class: "grid" }, h("section", { class: "card" }, list, more)));
  async function read(path) {
    const page = await get(path);
    rows.push(...page.runs);
    const head = [t("started"), t("verdict"), t("state"), t("method"), t("who"), ""];
    const cells = rows.map((run) => [
      h("a", { href: `#/run/${run.run_id}` }, said(utc(run.started))),
      verdictTag(run),
      stateName(run.state),
      said(run.method),
      said(run.operator || "–"),
      h("a", { href: `#/compare/${run.run_id}` }, t("compare")),
    ]);
    fill(list, rows.length ? table(head, cells, t("runs")) : h("p", { class: "dim" }, t("none")));
    fill(more, page.next ? h("button", { onclick: () => read(page.next.replace("/api/v1", "")) }, t("older")) : null);
  }
  return read("/runs?limit=25").then(() => null);
}

export async function runView(main, id) {
  const run = await get(`/runs/${encodeURIComponent(id)}`);
  const changes = run.transitions.map((one) => [said(utc(one.utc)), `${stateName(one.source)} → ${stateName(one.target)}`, said(one.detail ? `${one.reason}: ${one.detail}` : one.reason)]);
  const path = `/api/v1/runs/${encodeURIComponent(run.run_id)}`;
  fill(
    main,
    h("h1", {}, `${t("run")} `, said(run.run_id)),
    h(
      "div",
      { class: "grid" },
      card(
        t("verdict"),
        h("p", {}, verdictTag(run)),
        h(
          "dl",
          {},
          [[t("state"), stateName(run.state)], [t("reason"), said(run.reason)], [t("started"), said(utc(run.started))], [t("ended"), said(utc(run.ended))], [t("method"), said(run.method)], [t("who"), said(run.operator || "–")], [t("block"), said(run.block.identity ? `${run.block.identity.model} ${run.block.identity.serial}` : "–")]]
            .map(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]),
        ),
        h("p", {}, h("a", { href: `${path}/result` }, t("result")), " · ", h("a", { href: `${path}/samples`, download: "" }, t("samples")), " · ", h("a", { href: `#/compare/${run.run_id}` }, t("compare"))),
      ),
      card(t("transitions"), table([t("when"), t("what"), t("why")], changes, t("transitions"))),
      run.verdict !== null ? card(t("report"), h("p", {}, h("a", { href: `${path}/report`, target: "_blank" }, t("report"))), h("iframe", { src: `${path}/report`, title: t("report") })) : null,
    ),
  );
}

export async function compareView(main, firstId, secondId) {
  const list = (await get("/runs?limit=200")).runs.filter((run) => run.verdict !== null);
  const chosen = [firstId || list[0]?.run_id, secondId || list.find((run) => run.run_id !== (firstId || list[0]?.run_id))?.run_id];
  const pick = (which, label) =>
    h("label", { class: "field half" }, h("span", {}, label), h(
      "select",
      { onchange: (event) => { chosen[which] = event.target.value; location.hash = `#/compare/${chosen[0]}/${chosen[1]}`; } },
      list.map((run) => h("option", { value: run.run_id, selected: run.run_id === chosen[which] }, `${utc(run.started)} · ${run.verdict}`)),
    ));
  const body = h("div", { class: "grid" });
  fill(main, h("h1", {}, t("compare")), h("p", { class: "dim" }, t("compare_text")), h("div", { class: "grid" }, h("section", { class: "card" }, h("div", { class: "grid" }, pick(0, t("first")), pick(1, t("second"))))), body);
  if (!chosen[0] || !chosen[1]) {
    fill(body, h("p", { class: "dim" }, t("none")));
    return;
  }
  const [one, other] = await Promise.all(chosen.map((id) => get(`/runs/${encodeURIComponent(id)}/result`)));
  const terms = [one, other].map((result) => faceTerms(result.terms.final));
  const sigmas = [one, other].map((result) => faceSigma(result.sigma));
  const rows = SENSORS.map(([kind, axis, unit], i) => {
    const difference = terms[1][i] - terms[0][i];
    const spread = sigmas[0][i] === null || sigmas[1][i] === null ? null : Math.hypot(sigmas[0][i], sigmas[1][i]);
    return [`${t(kind)} ${axis}, ${unit}`, ...terms.map((list_, k) => said(`${list_[i].toFixed(4)} ± ${sigmas[k][i] === null ? "–" : sigmas[k][i].toFixed(4)}`)), said(difference.toFixed(4)), said(spread ? (difference / spread).toFixed(1) : "–")];
  });
  const about = [
    [t("verdict"), said(one.verdict), said(other.verdict)],
    [t("verification"), said(figures(one.verification?.chi_square ?? null)), said(figures(other.verification?.chi_square ?? null))],
    [`${t("temperature")}, °C`, said(figures(one.conditions.temperature_mean_c ?? null)), said(figures(other.conditions.temperature_mean_c ?? null))],
    [t("block"), said(one.block.identity?.serial ?? "–"), said(other.block.identity?.serial ?? "–")],
    [t("method"), said(one.method), said(other.method)],
  ];
  fill(
    body,
    card(t("final_terms"), table([t("sensor"), t("first"), t("second"), t("difference"), t("in_sigma")], rows, t("final_terms"))),
    card(t("circumstances"), table(["", t("first"), t("second")], about, t("circumstances"))),
  );
}
