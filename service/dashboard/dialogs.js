// Questions before commands: one dialog, answered by buttons or keys.

import { fill, h } from "./dom.js";
import { t } from "./i18n.js";

export function ask({ title, text, fields = [], verb, danger = false }) {
  const dialog = document.getElementById("dialog");
  return new Promise((resolve) => {
    const inputs = fields.map((field) => [field, makeInput(field)]);
    const form = h(
      "form",
      { method: "dialog", onsubmit: (event) => { event.preventDefault(); finish(Object.fromEntries(inputs.map(([field, input]) => [field.name, input.value.trim()]))); } },
      h("h2", { id: "dialog-title" }, title),
      text ? h("p", {}, text) : null,
      inputs.map(([field, input]) => h("label", { class: "field" }, h("span", {}, field.label), input, field.hint ? h("small", { class: "dim" }, field.hint) : null)),
      h(
        "div",
        { class: "buttons" },
        h("button", { type: "button", class: "quiet", onclick: () => finish(null) }, t("cancel")),
        h("button", { type: "submit", class: danger ? "danger" : "primary" }, verb),
      ),
    );
    const finish = (answer) => {
      dialog.oncancel = null;
      dialog.close();
      resolve(answer);
    };
    dialog.oncancel = (event) => { event.preventDefault(); finish(null); };
    fill(dialog, form);
    dialog.showModal();
  });
}

function makeInput(field) {
  if (field.choices) {
    return h("select", { name: field.name }, field.choices.map(([value, label]) => h("option", { value }, label)));
  }
  const input = h("input", { name: field.name, type: field.type || "text", required: field.required, step: "any", maxlength: "200", autocomplete: "off", dir: "auto" });
  input.value = field.value || "";
  return input;
}

let hiding = 0;

export function tell(text, bad = false) {
  const place = document.getElementById("toast");
  fill(place, h("p", { class: bad ? "toast bad" : "toast" }, h("span", { "aria-hidden": "true" }, bad ? "✕ " : "✓ "), text));
  clearTimeout(hiding);
  hiding = setTimeout(() => fill(place), 8000);
}
