// Commands to a run, and its questions.
import { byId, say, t } from "./base.js";
import { person, post } from "./shell.js";
import { ended, freshness, holdsLease, isOperator, isReplay, mayCommand, page } from "./state.js";

// Questions of the run: a dialog beside the page, not in front of it. Closing it answers nothing and stops nothing.

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

// Commands of an operator, the lease, and the answer of the run. What is not answered is said to be unknown.

const listeners = [];
export const onMayCommand = (listener) => listeners.push(listener);

function identity() {
  return [...crypto.getRandomValues(new Uint8Array(12))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

function showReply({ ok, text }) {
  byId("command-reply").classList.toggle("bad", !ok);
  say(byId("command-reply"), text);
}

/** Sends one command to the run and shows its answer. words: {command, reason, alarm, prompt, value}. */
export async function command(words) {
  showReply({ ok: true, text: t("command.sent") });
  const reply = await post("/api/v1/commands", { id: identity(), run: page.run, ...words });
  showReply(reply);
  return reply;
}

/** Takes the command, or gives it up. */
export async function lease(take) {
  const reply = await post("/api/v1/operator", { take });
  showReply(reply);
  if (reply.ok) { page.state = { ...page.state, operator: reply.said.operator ?? null }; await ask(); }
}

let whose = null;

/** Two people may have one name: only the server knows whose the command is, so it is asked whenever that changes. */
export async function followLease() {
  const mark = JSON.stringify(page.state.operator ?? null);
  if (mark === whose) return;
  whose = mark;
  await ask();
}

async function ask() {
  page.person = await person().catch(() => { whose = null; return { ...page.person, is_operator: false }; });
  showCommands();
}

/** What can be asked for now; buttons that would be refused are dead. */
export function showCommands() {
  const operator = isOperator();
  byId("commands").hidden = isReplay() || ended() || !page.everConnected;
  for (const id of ["pause", "resume", "abort"]) { byId(id).hidden = !operator; byId(id).disabled = !mayCommand(); }
  byId("pause").disabled ||= page.state.state === "holding";
  byId("resume").disabled ||= page.state.state !== "holding";
  const who = page.state.operator;
  say(byId("operator"), who ? t("operator.is", { name: who.name }) : t(operator ? "operator.nobody" : "operator.viewer"));
  byId("take").hidden = !operator || holdsLease();
  byId("give").hidden = !operator || !holdsLease();
  byId("take").disabled = byId("give").disabled = freshness() !== "fresh";
  for (const listener of listeners) listener();
}

/** The dialog that asks for a reason, and for Abort a second time. */
class Asking {
  constructor() {
    this.dialog = byId("reason");
    byId("reason-cancel").addEventListener("click", () => this.dialog.close());
    byId("reason-form").addEventListener("submit", (event) => { event.preventDefault(); this.next(); });
  }

  open(what) {
    this.what = what;
    this.sure = what !== "abort";
    byId("reason-value").value = "";
    say(byId("reason-trouble"), "");
    this.words(this.sure ? t(`command.${what}-title`) : t("command.abort-title"), this.sure ? t(`command.${what}-text`) : t("command.abort-text"),
      this.sure ? t(`command.${what}-go`) : t("command.abort-next"));
    byId("reason-field").hidden = false;
    this.dialog.classList.remove("final");
    this.dialog.showModal();
    byId("reason-value").focus();
  }

  words(title, text, go) {
    say(byId("reason-title"), title);
    say(byId("reason-text"), text);
    say(byId("reason-go"), go);
  }

  async next() {
    const reason = byId("reason-value").value.trim();
    if (!reason) { say(byId("reason-trouble"), t("command.reason-missing")); return; }
    if (!this.sure) {
      this.sure = true;
      this.dialog.classList.add("final");
      byId("reason-field").hidden = true;
      this.words(t("command.abort-sure"), t("command.abort-sure-text", { reason }), t("command.abort-go"));
      byId("reason-cancel").focus(); // a second Enter by mistake goes back
      return;
    }
    byId("reason-go").disabled = true;
    const reply = await command({ command: this.what, reason });
    byId("reason-go").disabled = false;
    if (reply.ok) this.dialog.close();
    else say(byId("reason-trouble"), reply.text);
  }
}

export function wireCommands() {
  const asking = new Asking();
  byId("pause").addEventListener("click", () => asking.open("pause"));
  byId("abort").addEventListener("click", () => asking.open("abort"));
  byId("resume").addEventListener("click", () => command({ command: "resume" }));
  byId("take").addEventListener("click", () => lease(true));
  byId("give").addEventListener("click", () => lease(false));
}
