// Below the benches: who is due, and the calibrations of all of them, from the history that the server was given.
import { byId, fillTable, icon, make, onSettings, say, t, word } from "./base.js";
import { stamp } from "./words.js";

const AT_ONCE = 20;
const EVERY_ms = 60_000;

const shown = { due: AT_ONCE, sessions: AT_ONCE };
let dues = [];
let sessions = [];

const when = (text) => stamp(Date.parse(text) / 1000);
const unitOf = (one) => [one.uut_model, one.uut_serial].filter(Boolean).join(" ");
const named = (one) => make("span", {}, unitOf(one), one.simulated ? make("span", { class: "soft" }, ` \u00b7 ${t("page.simulated")}`) : null);

function fill(name, columns, rows) {
  const heads = columns.map(([key, look]) => ({ head: t(key), class: look }));
  byId(`${name}-card`).hidden = !rows.length;
  fillTable(byId(name), heads, rows.slice(0, shown[name]), "");
  byId(`more-${name}`).hidden = rows.length <= shown[name];
}

function show() {
  fill("due", [["fleet.due-at", "fixed"], ["calibration.unit", ""], ["calibration.campaign", ""], ["fleet.last-at", "fixed"], ["fleet.governed", ""]], dues.map((one) => ({
    key: `${unitOf(one)} ${one.campaign} ${one.simulated}`,
    class: one.overdue ? "need-some" : "",
    cells: [make("span", { class: one.overdue ? "overdue" : "" }, one.overdue ? icon("warning") : null, when(one.due_utc).slice(0, 10), one.overdue ? ` ${t("fleet.overdue")}` : ""),
      named(one), one.campaign, when(one.last_utc).slice(0, 10), one.governed_by || t("fleet.interval")],
  })));
  fill("sessions", [["calibration.started", "fixed"], ["calibration.unit", ""], ["calibration.campaign", ""], ["calibration.session", ""], ["calibration.verdict", ""], ["calibration.approved", ""]],
    sessions.map((one) => ({
      key: `${one.session} ${one.session_sha256} ${one.revision}`,
      cells: [when(one.started_utc), named(one), one.campaign, one.session, one.verdict ? word("verdict", one.verdict) : "\u2013", (one.approved_by ?? []).join(", ")],
    })));
}

async function ask(path, name) {
  const reply = await fetch(path);
  const said = await reply.json().catch(() => ({}));
  if (!reply.ok) throw new Error(said.text ?? `HTTP ${reply.status}`);
  return said[name];
}

async function refresh() {
  if (document.hidden) return;
  try {
    [dues, sessions] = await Promise.all([ask("/api/v1/due", "due"), ask("/api/v1/calibrations", "calibrations")]);
    say(byId("no-history"), "");
    show();
  } catch (error) { // they change from day to day: what stands there stays, and is asked for again
    say(byId("no-history"), t("fleet.no-history", { why: error.message }));
  }
  byId("no-history").hidden = !byId("no-history").textContent;
}

export function showCalibrated() {
  for (const name of ["due", "sessions"]) byId(`more-${name}`).addEventListener("click", () => { shown[name] += AT_ONCE; show(); });
  onSettings((what) => { if (what === "time") show(); });
  refresh();
  setInterval(refresh, EVERY_ms);
}
