// Commands of an operator, the lease, and the answer of the run. What is not answered is said to be unknown.
import { byId, say } from "./dom.js";
import { person, post } from "./post.js";
import { ended, freshness, holdsLease, isOperator, isReplay, mayCommand, page } from "./state.js";
import { t } from "./texts.js";

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

let asked = null;

/** Two people may have one name: only the server knows whose the command is, so it is asked whenever that changes. */
export async function followLease() {
  const mark = JSON.stringify(page.state.operator ?? null);
  if (mark === asked) return;
  asked = mark;
  await ask();
}

async function ask() {
  page.person = await person().catch(() => { asked = null; return { ...page.person, is_operator: false }; });
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
