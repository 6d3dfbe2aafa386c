// Tables of the page: instruments, links, records, log.
import { byId, fillTable, say, t, word } from "./base.js";
import { page } from "./state.js";
import { conditions, duration, stamp } from "./words.js";

const number = { class: "number" };
const code = { class: "code" };
const fixed = { class: "fixed" };
const SEVERITIES = ["none", "warning", "alarm", "fault"];
const heads = (family, columns) => Object.entries(columns).map(([name, look]) => ({ head: t(`${family}.${name}`), class: look.class }));
const digits = (value, places) => (Number.isFinite(value) ? value.toFixed(places) : "");

function instruments() {
  const columns = heads("instrument", { state: fixed, role: fixed, command: code, reply: code, answer: number, age: number, errors: number, error: code });
  const now_s = page.t_s || page.state.t_utc_s;
  const rows = Object.entries(page.state.instruments ?? {}).map(([role, one]) => ({
    key: role,
    class: one.state ?? "",
    cells: [word("instrument.state", one.state), role, one.command ?? "", one.reply ?? "", digits(one.answer_ms, 0),
      one.t_utc_s ? duration(Math.max(0, now_s - one.t_utc_s)) : "", one.errors ?? "", one.error ?? ""],
  }));
  fillTable(byId("instruments"), columns, rows, t("instrument.none"));
  for (const [role, one] of Object.entries(page.state.instruments ?? {})) {
    const row = [...byId("instruments").tBodies[0].rows].find((element) => element.dataset.key === role);
    if (row) row.title = [one.driver, one.resource, one.identity, one.command, one.reply, one.error].filter(Boolean).join("\n");
  }
}

function links() {
  const columns = heads("link", { state: fixed, name: fixed, frames: number, bad: number, lost: number, jumps: number, duplicate: number, rate: number, age: number, reason: {} });
  const rows = Object.entries(page.state.links ?? {}).map(([name, one]) => ({
    key: name,
    class: { streaming: "ok", waiting: "" }[one.state] ?? "bad",
    cells: [word("link.state", one.state), name, one.frames ?? "", one.bad ?? "", one.lost ?? "", one.jumps ?? "", one.duplicate ?? "",
      digits(one.rate_Hz, 1), Number.isFinite(one.age_s) ? `${one.age_s.toFixed(1)} s` : "", one.reason ?? ""],
  }));
  fillTable(byId("links"), columns, rows, t("link.none"));
}

function records() {
  const { records: all } = page.state;
  say(byId("record-counts"), all ? t("record.counts", { done: all.done ?? 0, planned: all.planned ?? "\u2013", retaken: all.retaken ?? 0, flagged: all.flagged ?? 0 }) : "");
  const counted = (all?.last ?? []).some((one) => one.readings !== undefined) ? "readings" : "frames";
  const columns = heads("record", { number, time: fixed, conditions: {}, [counted]: number, lost: number, bad: number, flags: {} });
  const rows = (all?.last ?? []).map((one) => ({
    key: one.number,
    class: one.flags?.length ? "warn" : "",
    cells: [one.number, stamp(one.t_utc_s, page.state.started_utc_s), conditions({ ...one.conditions, kind: null }), one[counted] ?? "", one.lost ?? "", one.bad ?? "",
      Array.isArray(one.flags) ? one.flags.join(", ") : one.flags ?? ""],
  }));
  fillTable(byId("records"), columns, rows, t("record.none"));
}

export function showLog() {
  const wanted = byId("log-filter").value.trim().toLowerCase();
  const least = SEVERITIES.indexOf(byId("log-severity").value);
  const lines = (page.state.log ?? []).filter((one) => SEVERITIES.indexOf(one.severity ?? "none") >= least
    && (!wanted || `${one.kind} ${one.text}`.toLowerCase().includes(wanted)));
  const seen = new Map();
  const rows = lines.map((one) => {
    const key = `${one.t_utc_s} ${one.kind} ${one.text}`;
    seen.set(key, (seen.get(key) ?? 0) + 1);
    return { key: `${key} ${seen.get(key)}`, class: { warning: "warn", alarm: "bad", fault: "bad" }[one.severity] ?? "", cells: [stamp(one.t_utc_s, page.state.started_utc_s), one.kind, one.text] };
  });
  fillTable(byId("log"), heads("log", { time: fixed, kind: fixed, text: {} }), rows, t(wanted || least > 0 ? "log.no-match" : "log.none"));
}

let shown = {};

/** Fills what has changed; `everything` after a change of the form of time. */
export function showPanels(everything = false) {
  const { state } = page;
  if (everything) shown = {};
  for (const [name, fill] of Object.entries({ links, records, log: showLog })) {
    if (shown[name] !== state[name]) fill();
    shown[name] = state[name];
  }
  instruments();
}
