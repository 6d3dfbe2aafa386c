// Questions of the run: a dialog beside the page, not in front of it. Closing it answers nothing and stops nothing.
import { byId, say } from "./dom.js";
import { command, lease, onMayCommand } from "./commands.js";
import { holdsLease, isOperator, isReplay, mayCommand, page } from "./state.js";
import { t } from "./texts.js";

let shown = null; // id of the question the dialog is about

function limits({ unit, low, high }) {
  const known = (value) => value !== null && value !== undefined;
  if (known(low) && known(high)) return t("prompt.between", { low, high, unit: unit ?? "" });
  if (known(low)) return t("prompt.at-least", { low, unit: unit ?? "" });
  return known(high) ? t("prompt.at-most", { high, unit: unit ?? "" }) : t("prompt.value", { unit: unit ?? "" });
}

/** The question as a person is asked it: a ratio in percent. */
function asked() {
  const { prompt } = page.state;
  if (prompt?.unit !== "1") return prompt;
  const percent = (value) => (value === null || value === undefined ? value : Number((100 * value).toPrecision(12)));
  return { ...prompt, unit: "%", low: percent(prompt.low), high: percent(prompt.high) };
}

/** Whether this is answered at the bench, and this page was not opened there. The run decides; this only says so. */
const isElsewhere = ({ presence }) => presence === "bench" && page.person.role !== "bench";

/** What keeps this person from answering, and what they can do about it: nothing at all, or take the command. */
function showMay(prompt) {
  const elsewhere = isElsewhere(prompt), may = !elsewhere && mayCommand();
  say(byId("prompt-cannot"), elsewhere ? t("prompt.at-bench") : may ? "" : t("prompt.not-operator"));
  byId("prompt-cannot").hidden = may;
  byId("prompt-field").hidden = !prompt.unit || elsewhere;
  byId("prompt-go").hidden = byId("prompt-go").disabled = !may; // a dead one is not sent by Enter either
  byId("prompt-take").hidden = elsewhere || may || !isOperator() || holdsLease();
}

export function showPrompt() {
  const prompt = asked();
  const open = Boolean(prompt) && !isReplay();
  byId("show-prompt").hidden = !open;
  if (!open) { shown = null; byId("prompt").close(); return; }
  say(byId("prompt-title"), t(prompt.arms ? "prompt.arm-title" : "prompt.title"));
  say(byId("prompt-text"), prompt.text);
  say(byId("prompt-limits"), prompt.unit ? limits(prompt) : "");
  say(byId("prompt-go"), t(prompt.arms ? "prompt.arm" : "prompt.answer"));
  showMay(prompt);
  if (shown !== prompt.id) {
    shown = prompt.id;
    byId("prompt-value").value = "";
    say(byId("prompt-trouble"), "");
    byId("prompt").show();
  }
}

/** The value typed, or what is wrong with it. A number is in the unit asked for; with a unit it is for the run to judge. */
function answer({ unit, low, high }) {
  if (!unit) return { value: true };
  const typed = byId("prompt-value").value.trim().replace(",", ".");
  const value = Number(typed);
  if (!typed || !Number.isFinite(value)) return /^[-+.\d]/.test(typed) ? { value: typed } : { trouble: t("prompt.no-number") };
  if ((low ?? -Infinity) > value || value > (high ?? Infinity)) return { trouble: limits(asked()) };
  return { value: unit === "%" ? `${value} %` : value };
}

export function wirePrompt() {
  byId("prompt-close").addEventListener("click", () => byId("prompt").close());
  byId("prompt-take").addEventListener("click", () => lease(true));
  byId("show-prompt").addEventListener("click", () => { byId("prompt").close(); byId("prompt").show(); byId("prompt-value").focus(); });
  byId("prompt-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const prompt = asked();
    if (!prompt) return;
    const { value, trouble } = answer(prompt);
    if (trouble) { say(byId("prompt-trouble"), trouble); return; }
    const reply = await command({ command: "answer", prompt: prompt.id, value });
    say(byId("prompt-trouble"), reply.ok ? "" : reply.text);
    if (reply.ok) byId("prompt").close();
  });
  onMayCommand(showPrompt);
}
