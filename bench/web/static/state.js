// What the page knows, and how fresh it is. RUNNING is a claim about now: it is shown only while the run answers.
const OLD_AFTER_s = 3;

const listeners = new Map();

export const page = {
  run: document.body.dataset.run,
  state: {},
  person: { name: "", role: "viewer", is_operator: false },
  connected: false,
  everConnected: false,
  heard_ms: -Infinity, // performance.now() of the last message
  age_s: 0, // since the run answered last, as of the last heartbeat
  t_s: NaN, // bench time of the newest thing heard
};

export function on(topic, listener) {
  if (!listeners.has(topic)) listeners.set(topic, []);
  listeners.get(topic).push(listener);
}

export function tell(topic, value) {
  for (const listener of listeners.get(topic) ?? []) listener(value);
}

export const ended = () => ["ended", "stopped"].includes(page.state.state);
export const isReplay = () => page.state.source === "replay";

/** Seconds since the run was heard of last, through the server. */
export function age_s() {
  const silence_s = (performance.now() - page.heard_ms) / 1000;
  return isReplay() || ended() ? silence_s : silence_s + Math.max(0, page.age_s ?? 0);
}

/** True while the server is heard, whether or not the run answers it. */
export const serverAnswers = () => page.connected && (performance.now() - page.heard_ms) / 1000 <= OLD_AFTER_s;

/** `fresh`, `old` (nothing heard, or the run does not answer), `gone` (no connection), `connecting` (none yet). */
export function freshness() {
  if (!page.everConnected) return "connecting";
  if (!page.connected) return "gone";
  return age_s() > OLD_AFTER_s ? "old" : "fresh";
}

/** True for a person with a token that commands: an operator, or whoever is at the bench. */
export const isOperator = () => page.person.role !== "viewer";

/** True if this person may command now: operator, holding the command, at a living run that answers. */
export function mayCommand() {
  return isOperator() && !isReplay() && !ended() && freshness() === "fresh" && holdsLease();
}

export function holdsLease() {
  return Boolean(page.state.operator) && page.person.is_operator === true;
}
