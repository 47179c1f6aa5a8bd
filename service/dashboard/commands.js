// Commands of the operator, each after a question; what the service refuses is told with its reason.

import { call, lease, session, takeLease, releaseLease } from "./api.js";
import { ask, tell } from "./dialogs.js";
import { t } from "./i18n.js";

const me = () => session.name && session.name !== "local" ? session.name : localStorage.getItem("inertrim.operator") || "";
const nameField = () => ({ name: "operator", label: t("operator"), value: me(), required: true });
const reasonField = (required = true) => ({ name: "reason", label: t("reason"), required });

async function carryOut(answer, act) {
  if (!answer) return;
  if (answer.operator) localStorage.setItem("inertrim.operator", answer.operator);
  try {
    await act(answer);
    tell(t("confirm_done"));
  } catch (error) {
    tell(error.message, true);
  }
}

export async function startRun() {
  const answer = await ask({
    title: t("start"),
    text: t("start_text"),
    verb: t("start"),
    fields: [
      nameField(),
      { name: "method", label: t("method"), choices: [["optimal", "optimal"], ["paper", "paper"]] },
      { name: "azimuth", label: t("azimuth"), type: "number" },
      { name: "alignment", label: t("alignment"), choices: [["", t("alignment_rest")], ["inertial", t("alignment_inertial")]] },
    ],
  });
  await carryOut(answer, ({ operator, method, azimuth, alignment }) =>
    call("POST", "/runs", { operator, method, azimuth_deg: azimuth === "" ? null : Number(azimuth), alignment: alignment || null }),
  );
}

export async function abortRun(runId) {
  const answer = await ask({ title: t("abort"), text: t("abort_text", { run: runId }), verb: t("abort"), danger: true, fields: [nameField(), reasonField()] });
  await carryOut(answer, (note) => call("POST", `/runs/${encodeURIComponent(runId)}/abort`, note));
}

export async function acknowledgeFault(runId, reason) {
  const answer = await ask({ title: t("acknowledge_fault"), text: t("acknowledge_text", { reason }), verb: t("acknowledge"), fields: [nameField(), reasonField()] });
  await carryOut(answer, (note) => call("POST", `/runs/${encodeURIComponent(runId)}/acknowledge`, note));
}

export async function acknowledgeCondition(name, title) {
  const answer = await ask({ title: `${t("acknowledge")}: ${title}`, text: t("acknowledge_condition"), verb: t("acknowledge"), fields: [nameField(), reasonField()] });
  await carryOut(answer, (note) => call("POST", `/conditions/${name}/acknowledge`, note));
}

export async function takeCommand() {
  const over = lease.holder !== null;
  const answer = await ask({
    title: over ? t("take_over") : t("take"),
    text: over ? t("take_over_text", { holder: lease.holder }) : t("take_text"),
    verb: over ? t("take_over") : t("take"),
    danger: over,
    fields: [nameField(), ...(over ? [reasonField()] : [])],
  });
  await carryOut(answer, ({ operator, reason }) => takeLease(operator, over, reason));
}

export const giveCommand = () => carryOut({}, releaseLease);
