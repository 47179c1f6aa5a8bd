// What runs and simulators believe in: calibrations, and block models with what each was made from.

import { get } from "./api.js";
import { card, fill, h, said, table } from "./dom.js";
import { t } from "./i18n.js";

export async function libraryView(main) {
  const [calibrations, models] = await Promise.all([get("/calibrations"), get("/models")]);
  const documents = await Promise.all(models.entries.map((one) => (one.error ? null : get(`/models/${encodeURIComponent(one.name)}`).catch(() => null))));
  const dates = await Promise.all(calibrations.entries.map((one) => (one.error ? null : get(`/calibrations/${encodeURIComponent(one.name)}`).catch(() => null))));
  const rows = calibrations.entries.map((one, i) => [h("span", {}, said(one.name), one.in_use ? [" ", h("span", { class: "tag good" }, t("in_use"))] : null), said(one.block || "–"), said(dates[i]?.date || "–"), one.error ? h("span", {}, t("unreadable"), ": ", said(one.error)) : said(one.sha256.slice(0, 16))]);
  const nodes = models.entries.map((one, i) => ({ ...one, parent: documents[i]?.parent ?? null, effects: documents[i]?.effects ?? [] }));
  const known = new Set(nodes.map((one) => one.sha256));
  const branch = (parent) => {
    const children = nodes.filter((one) => (parent === null ? !one.parent || !known.has(one.parent) : one.parent === parent));
    if (!children.length) return null;
    return h("ul", { class: parent === null ? "" : "lineage" }, children.map((one) => h(
      "li",
      {},
      h("b", {}, said(one.name)), " ", one.in_use ? [h("span", { class: "tag good" }, t("in_use")), " "] : null,
      one.error ? h("span", {}, t("unreadable"), ": ", said(one.error)) : h("span", { class: "dim" }, said(`${one.block || ""} ${one.sha256.slice(0, 16)}`)),
      one.parent && parent === null ? h("span", { class: "dim" }, ` · ${t("parent")} `, said(one.parent.slice(0, 16))) : null,
      one.effects.length ? h("div", { class: "dim" }, `${t("effects")}: `, said(one.effects.map((effect) => `${effect.effect} (${effect.channel})`).join(", "))) : null,
      one.sha256 ? branch(one.sha256) : null,
    )));
  };
  fill(
    main,
    h("h1", {}, t("library")),
    h(
      "div",
      { class: "grid" },
      card(t("calibrations"), rows.length ? table([t("name"), t("block"), t("date"), t("hash")], rows, t("calibrations")) : h("p", { class: "dim" }, t("none"))),
      card(t("models"), branch(null) || h("p", { class: "dim" }, t("none"))),
    ),
  );
}
