// The head of the page: what the run does, how far it is, and above all whether that is still true.
import { showBench } from "./bench-state.js";
import { byId, say, setIcon } from "./dom.js";
import { age_s, ended, freshness, isReplay, page, serverAnswers } from "./state.js";
import { t, withCode, word } from "./texts.js";
import { clock, duration, stamp } from "./time.js";
import { inUnits } from "./units.js";

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
  const { wait, started_utc_s: started_s } = page.state;
  if (!wait) return "";
  const now_s = page.t_s || page.state.t_utc_s;
  return [
    t("status.wait", { reason: inUnits(wait.reason) }),
    wait.since_utc_s ? t("status.since", { time: clock(wait.since_utc_s, started_s), gone: duration(now_s - wait.since_utc_s) }) : "",
    wait.until_utc_s ? t("status.until", { time: clock(wait.until_utc_s, started_s) }) : "",
    wait.last ? t("status.last", { last: inUnits(wait.last) }) : "",
  ].filter(Boolean).join(" \u00b7 ");
}

function holdLine() {
  return Object.entries(page.state.holds ?? {}).map(([name, reason]) => t("status.hold", { name, reason })).join("; ");
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
  show("holds", holdLine());
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
