// What stands above the figures: state, alarms, outcome, replay.
import { byId, icon, inUnits, make, say, setIcon, t, withCode, word } from "./base.js";
import { command, onMayCommand } from "./commands.js";
import { age_s, ended, freshness, isReplay, mayCommand, page, serverAnswers } from "./state.js";
import { clock, duration, showBench, stamp } from "./words.js";

// Alarms: they stay until acknowledged and over; each is announced once.

const items = new Map();
const announced = new Set();

function item(alarm) {
  const known = items.get(alarm.id);
  if (known) return known;
  const parts = { time: make("span"), text: make("span", { class: "text" }), state: make("span", { class: "soft" }) };
  const button = make("button", { type: "button", onclick: () => command({ command: "acknowledge", alarm: alarm.id }) }, t("alarm.acknowledge"));
  const element = make("li", { class: alarm.severity },
    make("span", { class: "word" }, icon(alarm.severity), word("alarm", alarm.severity)), parts.time, parts.text, parts.state, button);
  const made = { element, button, ...parts };
  items.set(alarm.id, made);
  return made;
}

function stateOf(alarm) {
  const now = alarm.active ? t("alarm.active") : t("alarm.over");
  const by = alarm.acknowledged ? t("alarm.by", { by: alarm.acknowledged.by, time: stamp(alarm.acknowledged.t_utc_s, page.state.started_utc_s) }) : "";
  const { shelved } = alarm;
  const shelf = shelved ? t("alarm.shelved", { time: stamp(shelved.until_utc_s, page.state.started_utc_s), by: shelved.by, reason: shelved.reason }) : "";
  return [now, by, shelf].filter(Boolean).join(" \u00b7 ");
}

export function showAlarms() {
  const alarms = page.state.alarms ?? [];
  byId("alarms-card").hidden = !alarms.length;
  const elements = alarms.map((alarm) => {
    const one = item(alarm);
    one.element.classList.toggle("quiet", Boolean(alarm.acknowledged || alarm.shelved || (!alarm.active && ended())));
    say(one.time, stamp(alarm.t_utc_s, page.state.started_utc_s));
    say(one.text, withCode(alarm.code, alarm.text, " "));
    say(one.state, stateOf(alarm));
    one.button.hidden = Boolean(alarm.acknowledged) || page.state.source === "replay";
    one.button.disabled = !mayCommand();
    return one.element;
  });
  const list = byId("alarms");
  if (list.children.length !== elements.length || elements.some((element, index) => list.children[index] !== element)) list.replaceChildren(...elements);
  for (const id of [...items.keys()]) if (!alarms.some((alarm) => alarm.id === id)) items.delete(id);
  announce(alarms);
}

function announce(alarms) {
  const fresh = alarms.filter((alarm) => alarm.active && !alarm.acknowledged && !alarm.shelved && !announced.has(alarm.id));
  for (const id of [...announced]) if (!alarms.some((alarm) => alarm.id === id)) announced.delete(id);
  if (!fresh.length) return;
  for (const alarm of fresh) announced.add(alarm.id);
  byId("announce").replaceChildren(...fresh.map((alarm) => make("p", {}, `${word("alarm", alarm.severity)}: ${alarm.text}`)));
}

onMayCommand(showAlarms);

// A run that is over: how it ended, what it is worth, and what was written of it.

const FILES = ["report", "pdf", "certificate", "specimen"];

function lines({ outcome, duration_s: lasted_s }) {
  const soundness = outcome.verdicts ? (outcome.doubtful ? t("outcome.unsound", { count: outcome.doubtful }) : t("outcome.sound")) : "";
  const off = outcome.off === null || outcome.off === undefined ? "" : t(outcome.off ? "outcome.off" : "outcome.not-off");
  return [[t("outcome.lasted", { duration: duration(lasted_s) }), soundness, off].filter(Boolean).join(" \u00b7 "), outcome.why].filter(Boolean);
}

export function showOutcome() {
  const element = byId("session-outcome");
  const { session } = page.state;
  element.hidden = !session;
  const mark = JSON.stringify(session ?? null);
  if (!session || element.dataset.mark === mark) return;
  element.dataset.mark = mark;
  element.dataset.outcome = session.outcome.word;
  const links = FILES.filter((name) => session.files[name]).map((name) => make("a", { class: "button", id: name,
    href: `/api/v1/runs/${encodeURIComponent(page.run)}/${name}` }, t(`outcome.${name}`)));
  element.replaceChildren(make("h2", { class: "unseen" }, t("outcome.title")), make("strong", { class: "outcome-word" }, icon(`outcome-${session.outcome.word}`), t(`outcome.${session.outcome.word}`)),
    make("div", {}, ...lines(session).map((line) => make("p", {}, line))), make("p", { class: "buttons" }, ...links));
}

// A recording shown as if it were now: band, position, speed.

const STEPS = 1000;
let dragging = false;

export function showReplay() {
  const { replay } = page.state;
  byId("replay-band").hidden = byId("replay").hidden = !isReplay();
  if (!isReplay() || !replay) return;
  const at_s = replay.at_utc_s ?? page.t_s;
  const text = stamp(at_s, page.state.started_utc_s);
  say(byId("replay-at"), t("replay.at", { time: text }));
  say(byId("replay-play"), t(replay.playing ? "replay.pause" : "replay.play"));
  byId("replay-play").setAttribute("aria-pressed", String(Boolean(replay.playing)));
  if (document.activeElement !== byId("replay-speed")) byId("replay-speed").value = String(replay.speed);
  if (dragging) return;
  const slider = byId("replay-position");
  slider.value = Math.round(((at_s - replay.first_utc_s) / (replay.last_utc_s - replay.first_utc_s || 1)) * STEPS);
  slider.setAttribute("aria-valuetext", text);
  say(byId("replay-time"), text);
}

export function wireReplay(connection) {
  const send = (words) => connection.send({ type: "replay", ...words });
  const slider = byId("replay-position");
  const chosen_s = () => page.state.replay.first_utc_s + (slider.value / STEPS) * (page.state.replay.last_utc_s - page.state.replay.first_utc_s);
  byId("replay-play").addEventListener("click", () => send({ playing: !page.state.replay?.playing }));
  byId("replay-start").addEventListener("click", () => send({ at_utc_s: page.state.replay?.first_utc_s }));
  byId("replay-speed").addEventListener("change", () => send({ speed: Number(byId("replay-speed").value) }));
  slider.addEventListener("input", () => { dragging = true; say(byId("replay-time"), stamp(chosen_s(), page.state.started_utc_s)); });
  slider.addEventListener("change", () => { dragging = false; send({ at_utc_s: chosen_s() }); });
}

// The head of the page: what the run does, how far it is, and above all whether that is still true.

/** State as shape and word; never that of a run nobody hears. */
function badge(fresh) {
  const { state } = page.state;
  const shown = fresh === "fresh" ? state : fresh === "connecting" ? "connecting" : "old";
  byId("badge").dataset.state = shown;
  setIcon(byId("badge").querySelector("svg"), shown === "old" ? "lost" : shown ?? "connecting");
  const known = isReplay() ? t("state.replayed", { state: word("state", shown) }) : word("state", shown);
  say(byId("badge-word"), shown === "old" ? t(fresh === "gone" ? "state.not-connected" : "state.no-answer") : known);
}

function stepLine() {
  const { step } = page.state;
  if (!step) return "";
  const place = t("status.step", { number: step.number, of: step.of });
  const now_s = page.t_s || page.state.t_utc_s;
  const times = step.until_utc_s && page.state.state !== "ended"
    ? t("status.of", { gone: duration(now_s - step.since_utc_s), all: duration(step.until_utc_s - step.since_utc_s) }) : "";
  return [place, inUnits(step.what), times].filter(Boolean).join(" \u00b7 ");
}

function waitLine() {
  const { holds, wait, started_utc_s: started_s } = page.state;
  if (!wait) return "";
  const held = Object.entries(holds ?? {}).map(([name, reason]) => t("status.hold", { name, reason })).join("; ");
  const now_s = page.t_s || page.state.t_utc_s;
  return [
    held || t("status.wait", { reason: inUnits(wait.reason) }),
    wait.since_utc_s ? t("status.since", { time: clock(wait.since_utc_s, started_s), gone: duration(now_s - wait.since_utc_s) }) : "",
    wait.until_utc_s ? t("status.until", { time: clock(wait.until_utc_s, started_s) }) : "",
    wait.last ? t("status.last", { last: inUnits(wait.last) }) : "",
  ].filter(Boolean).join(" \u00b7 ");
}

function outcomeLine() {
  const { outcome } = page.state;
  return outcome ? withCode(outcome.error, outcome.text, ": ") : "";
}

function etaLine() {
  const { eta, started_utc_s: started_s } = page.state;
  if (!eta) return "";
  const spread_s = Math.max(eta.latest_utc_s - eta.likely_utc_s, eta.likely_utc_s - eta.earliest_utc_s);
  const range = spread_s < 1 ? "" : t("status.eta-range", { first: clock(eta.earliest_utc_s, started_s), last: clock(eta.latest_utc_s, started_s) });
  return [t("status.eta", { time: stamp(eta.likely_utc_s, started_s) }), range].filter(Boolean).join(", ");
}

function show(id, text) {
  byId(id).hidden = !text;
  say(byId(id), text);
}

function bench(fresh) {
  const { bench: told, guard, state } = page.state;
  const heard = fresh === "fresh" || (state === "lost" && serverAnswers()); // what the guard did is told by the server
  showBench(byId("bench"), told, { heard, now_s: page.t_s || page.state.t_utc_s, guard });
}

export function showAge() {
  const fresh = freshness();
  bench(fresh);
  const element = byId("age");
  document.body.dataset.fresh = fresh;
  badge(fresh);
  const age = age_s();
  element.classList.toggle("past", isReplay() || ended());
  element.classList.toggle("old", fresh === "old" || fresh === "gone");
  if (fresh === "connecting") say(element, t("age.connecting"));
  else if (fresh === "fresh") say(element, isReplay() ? t("age.replay") : ended() ? t("age.ended") : t("age.live", { age: age.toFixed(1) }));
  else say(element, t("age.old", { age: age < 90 ? `${Math.floor(age)} s` : duration(age) }));
}

export function showHead() {
  const { state } = page;
  say(byId("title"), state.title || page.run);
  const unit = state.uut ? t("status.uut", { model: state.uut.model ?? "", serial: state.uut.serial ?? "" }) : "";
  say(byId("what-runs"), [page.run, unit, state.station, state.clock === "virtual" ? t("status.virtual") : ""].filter(Boolean).join(" \u00b7 "));
  byId("simulated").hidden = byId("watermark").hidden = !state.simulated;
  say(byId("step"), stepLine());
  show("wait", waitLine());
  byId("badge").dataset.attention = state.attention ?? "none";
  show("outcome", outcomeLine());
  show("unwatched", (state.unwatched ?? []).join("; "));
  const percent = Math.round((state.progress ?? 0) * 1000) / 10;
  byId("progress").setAttribute("aria-valuenow", percent);
  byId("progress").firstElementChild.style.width = `${percent}%`;
  say(byId("percent"), state.progress === null || state.progress === undefined ? "" : `${percent.toFixed(1)} %`);
  say(byId("eta"), etaLine());
  document.title = `${word("state", state.state)} \u2013 ${state.title || page.run}`;
  showAge();
  if (freshness() !== "fresh") document.title = `${t("state.not-connected")} \u2013 ${state.title || page.run}`;
}
