// The start page: what runs now, the sessions of the folder, the calibration history.
import { byId, fillTable, icon, inUnits, loadTexts, make, onSettings, say, t, withCode, word } from "./base.js";
import { greet, wireKeys, wireSettings } from "./shell.js";
import { showBench, stamp } from "./words.js";

const AT_ONCE = 50;
const EVERY_ms = 3000;
const STALE_ms = 5000; // a state that is older is not known any more
const LIVING = ["starting", "running", "waiting", "holding", "ending", "lost"];
const ATTENTION = ["much", "some", "none"]; // who needs somebody stands first
const OUTCOMES = ["pass", "conditional_pass", "fail", "conditional_fail", "doubtful", "not_judged", "no_results", "fault", "stopped", "damaged"];
let runs = [];
let calibrations = [];
let shown = AT_ONCE;
let chosen = ""; // outcome that the list is filtered by
let heard_ms = -Infinity;

const fresh = () => performance.now() - heard_ms <= STALE_ms;

const address = (run) => `/runs/${encodeURIComponent(run)}`;
const unitOf = (run) => [run.uut?.model, run.uut?.serial].filter(Boolean).join(" ");

function card(run) {
  const { now } = run;
  const heard = fresh();
  const state = heard ? run.state : "lost";
  const bench = make("div", { class: "bench" });
  showBench(bench, now?.bench, { heard, now_s: now?.t_utc_s, guard: now?.guard });
  const lines = [
    now?.prompt ? t("start.asks", { text: now.prompt }) : now?.wait ? t("start.waits", { reason: inUnits(now.wait.reason) }) : inUnits(now?.what),
    ["lost", "stopped"].includes(run.state) ? t("start.gone") : "",
    now?.guard ? t("start.guard", { reason: now.guard.reason }) : "",
    [Number.isFinite(now?.progress) ? `${(100 * now.progress).toFixed(1)} %` : "", now?.eta ? t("start.end", { time: stamp(now.eta.likely_utc_s) }) : ""].filter(Boolean).join(" \u00b7 "),
  ].filter(Boolean);
  return make("a", { href: address(run.run), class: "run-card", "data-attention": heard ? now?.attention ?? "none" : "much", "data-state": state },
    make("span", { class: "head" }, icon(state), make("strong", {}, word("state", state)), alarmsOf(now), run.simulated ? make("span", { class: "tag" }, t("page.simulated")) : null),
    make("strong", { class: "name" }, run.title || run.run), make("span", { class: "soft" }, [unitOf(run), stamp(run.started_utc_s)].filter(Boolean).join(" \u00b7 ")),
    ...lines.map((line) => make("span", {}, line)), ...(now?.alarms ?? []).map((alarm) => make("span", { class: "alarm-line" }, `${word("alarm", alarm.severity)} ${withCode(alarm.code, alarm.text, " ")}`)), bench);
}

function alarmsOf(now) {
  if (!now?.alarm_count) return null;
  return make("span", { class: "alarm-count" }, icon("alarm"), t(now.alarm_count === 1 ? "start.alarm" : "start.alarms", { count: now.alarm_count }));
}

function living() {
  const found = runs.filter((run) => LIVING.includes(run.state) || run.now)
    .sort((one, other) => ATTENTION.indexOf(one.now?.attention) - ATTENTION.indexOf(other.now?.attention));
  byId("living").replaceChildren(...(found.length ? found.map(card) : [make("p", { class: "soft" }, t("start.no-living"))]));
}

const outcomeOf = (run) => run.outcome?.word ?? "";

/** Sessions that are over: newest first, damaged ones last. */
function ended() {
  const over = runs.filter((run) => !LIVING.includes(run.state));
  return [...over.filter((run) => outcomeOf(run) !== "damaged"), ...over.filter((run) => outcomeOf(run) === "damaged")];
}

function filters(over) {
  const counts = new Map();
  for (const run of over) counts.set(outcomeOf(run), (counts.get(outcomeOf(run)) ?? 0) + 1);
  const names = ["", ...OUTCOMES.filter((name) => counts.has(name))];
  byId("outcomes").replaceChildren(...names.map((name) => make("button", { type: "button", "aria-pressed": String(chosen === name), "data-outcome": name,
    onclick: () => { chosen = name; shown = AT_ONCE; sessions(); } }, `${name ? t(`outcome.${name}`) : t("start.all")} ${name ? counts.get(name) : over.length}`)));
}

function outcome(run) {
  const { word: name, why, off } = run.outcome ?? {};
  if (!name) return "";
  return make("span", { class: "outcome", "data-outcome": name, title: why ?? "" }, make("strong", {}, icon(`outcome-${name}`), t(`outcome.${name}`)),
    off === false ? make("strong", { class: "not-off" }, ` ${t("start.not-off")}`) : null,
    why ? make("span", { class: "soft" }, ` ${why.slice(0, 120)}`) : null);
}

function counts(run) {
  const verdicts = run.outcome?.verdicts;
  if (!verdicts) return "";
  const found = { ...verdicts, doubtful: run.outcome.doubtful };
  return OUTCOMES.filter((name) => found[name]).map((name) => t(`start.counts.${name}`, { count: found[name] })).join(", ")
    || t("start.counts.none", { count: Object.values(verdicts).reduce((sum, count) => sum + count, 0) });
}

function sessions() {
  const wanted = byId("search").value.trim().toLowerCase().split(/\s+/).filter(Boolean);
  const over = ended();
  filters(over);
  const found = over.filter((run) => {
    const text = [run.run, run.title, unitOf(run), word("outcome", outcomeOf(run)), stamp(run.started_utc_s)].join(" ").toLowerCase();
    return (!chosen || outcomeOf(run) === chosen) && wanted.every((one) => text.includes(one));
  });
  const columns = [["started", "fixed"], ["outcome", ""], ["run", ""], ["unit", "fixed"], ["verdict", ""], ["records", "number"]]
    .map(([name, look]) => ({ head: t(`start.${name}`), class: look }));
  const rows = found.slice(0, shown).map((run) => ({
    key: run.run,
    cells: [stamp(run.started_utc_s), outcome(run), link(run), unitOf(run), counts(run), recordsOf(run)],
  }));
  fillTable(byId("sessions"), columns, rows, t(wanted.length || chosen ? "start.no-match" : "start.no-sessions"));
  say(byId("found"), t("start.found", { shown: rows.length, found: found.length }));
  byId("more").hidden = found.length <= shown;
}

/** Done and planned; what is not known is a dash, so that no planned number passes for a done one. */
function recordsOf({ records }) {
  const [done, planned] = [records?.done ?? null, records?.planned ?? null];
  return done === null && planned === null ? "" : `${done ?? "\u2013"} / ${planned ?? "\u2013"}`;
}

function link(run) {
  return make("span", {}, make("a", { href: address(run.run) }, run.title || run.run),
    make("span", { class: "soft" }, ` ${run.run}${run.simulated ? ` \u00b7 ${t("page.simulated")}` : ""}`));
}

function history() {
  byId("no-calibrations").hidden = calibrations.length > 0;
  byId("calibrations").parentElement.hidden = !calibrations.length; // nothing to stop at with Tab
  if (!calibrations.length) return;
  const columns = ["started", "unit", "campaign", "session", "method", "verdict", "estimates", "revision", "approved"]
    .map((name) => ({ head: t(`calibration.${name}`), class: ["estimates", "revision"].includes(name) ? "number" : name === "session" ? "" : "fixed" }));
  const here = new Set(runs.map((run) => run.run));
  const rows = calibrations.map((one) => ({
    key: `${one.session} ${one.session_sha256} ${one.revision}`,
    cells: [stamp(Date.parse(one.started_utc) / 1000), [one.uut_model, one.uut_serial].filter(Boolean).join(" "), one.campaign,
      calibrated(one, here.has(one.session)), one.method ?? "", one.verdict ? word("verdict", one.verdict) : "–", one.estimates ?? "", one.revision ?? "",
      (one.approved_by ?? []).join(", ")],
  }));
  fillTable(byId("calibrations"), columns, rows, "");
}

/** The session of a calibration, as a link where it is in this folder. */
function calibrated(one, here) {
  const name = here ? make("a", { href: address(one.session) }, one.session) : one.session;
  return make("span", {}, name, one.simulated ? make("span", { class: "soft" }, ` \u00b7 ${t("page.simulated")}`) : "");
}

async function ask(path, name) {
  const reply = await fetch(path);
  if (!reply.ok) throw new Error(`HTTP ${reply.status}`);
  const found = await reply.json();
  return Array.isArray(found) ? found : found[name] ?? [];
}

async function refresh() {
  if (document.hidden) return;
  try {
    runs = await ask("/api/v1/runs", "runs");
    heard_ms = performance.now();
    byId("trouble").hidden = true;
  } catch {
    byId("trouble").hidden = false;
    say(byId("trouble"), t("trouble.server"));
    living();
    return;
  }
  living();
  sessions();
}

async function begin() {
  wireSettings();
  wireKeys();
  await loadTexts();
  await greet();
  byId("search").addEventListener("input", () => { shown = AT_ONCE; sessions(); });
  byId("more").addEventListener("click", () => { shown += AT_ONCE; sessions(); });
  onSettings((what) => { if (what === "time") { living(); sessions(); history(); } });
  await refresh();
  calibrations = await ask("/api/v1/calibrations", "calibrations").catch(() => []);
  history();
  setInterval(refresh, EVERY_ms);
  let known = true;
  setInterval(() => { if (known !== fresh()) { known = fresh(); living(); } }, 500);
  document.addEventListener("visibilitychange", () => { living(); refresh(); });
  addEventListener("pageshow", living); // a page from the cache of the browser says what it heard long ago
}

begin();
