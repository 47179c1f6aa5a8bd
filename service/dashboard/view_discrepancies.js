// Where simulation and measurement disagree: start the search on a run, follow it, read what it found, adopt its model.

import { call, get, may } from "./api.js";
import { ask, tell } from "./dialogs.js";
import { fill, h, said, table, utc } from "./dom.js";
import { t } from "./i18n.js";
import { live } from "./live.js";

export function discrepanciesView(main) {
  const list = h("div");
  const start = h("button", { class: "primary", disabled: !may("operator"), onclick: begin }, t("disc_start"));
  fill(main, h("h1", {}, t("discrepancies")), h("p", { class: "dim" }, t("disc_text")), h("div", { class: "grid" }, h("section", { class: "card" }, h("div", { class: "buttons" }, start), list)));

  async function begin() {
    const [runs, known] = await Promise.all([get("/runs?limit=50"), get("/discrepancies")]);
    const choices = [...runs.runs.filter((run) => run.verdict !== null).map((run) => [`run:${run.run_id}`, `${utc(run.started)} · ${run.verdict}`]), ...known.recordings.map((name) => [`name:${name}`, name])];
    if (!choices.length) return tell(t("disc_nothing"), true);
    const answer = await ask({ title: t("disc_start"), text: t("disc_text"), verb: t("disc_start"), fields: [{ name: "recording", label: t("run"), choices }, { name: "operator", label: t("operator"), required: true, value: localStorage.getItem("inertrim.operator") || "" }] });
    if (!answer) return;
    const [kind, name] = [answer.recording.slice(0, answer.recording.indexOf(":")), answer.recording.slice(answer.recording.indexOf(":") + 1)];
    await act(() => call("POST", "/discrepancies", { recordings: [kind === "run" ? { run_id: name } : { name }], operator: answer.operator }));
  }

  async function adopt(job) {
    const answer = await ask({ title: t("adopt"), text: t("adopt_text"), verb: t("adopt"), fields: [{ name: "operator", label: t("operator"), required: true }, { name: "reason", label: t("reason"), required: true }] });
    if (answer) await act(() => call("POST", "/models/adopt", { sha256: job.found, ...answer }));
  }

  async function act(command) {
    try {
      await command();
      tell(t("confirm_done"));
    } catch (error) {
      tell(error.message, true);
    }
    read();
  }

  async function read() {
    const found = await get("/discrepancies");
    const rows = found.discrepancies.map((job) => [
      said(utc(job.started)),
      said(job.operator),
      h("div", {}, h("progress", { max: "1", value: String(job.progress), "aria-label": t("progress") }), said(job.error || job.text)),
      job.verdict ? h("span", { class: "tag busy" }, said(job.verdict)) : said(job.state),
      h("span", {}, job.verdict ? h("a", { href: job.links.report, target: "_blank" }, t("report")) : null, " ", job.found && may("maintainer") ? h("button", { onclick: () => adopt(job) }, t("adopt")) : null),
    ]);
    fill(list, rows.length ? table([t("started"), t("who"), t("progress"), t("verdict"), ""], rows, t("discrepancies")) : h("p", { class: "dim" }, t("disc_none")));
  }

  const onEvent = () => read().catch(() => null);
  live.addEventListener("discrepancy", onEvent);
  return read().then(() => () => live.removeEventListener("discrepancy", onEvent));
}
