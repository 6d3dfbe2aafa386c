// What is said in words: times, conditions, the state of the bench.
import { icon, make, t, timeForm, unitText, word } from "./base.js";

// Times as people read them. Everything inside is seconds since 1970, UTC; only here they become text.

const two = (number) => String(number).padStart(2, "0");

/** Offset of local time at that instant in minutes east of UTC. */
const offsetMinutes = (t_s) => -new Date(t_s * 1000).getTimezoneOffset();

function zone(t_s) {
  if (timeForm() !== "local") return "Z";
  const minutes = offsetMinutes(t_s);
  return `${minutes < 0 ? "-" : "+"}${two(Math.floor(Math.abs(minutes) / 60))}:${two(Math.abs(minutes) % 60)}`;
}

function parts(t_s) {
  const shift_s = timeForm() === "local" ? offsetMinutes(t_s) * 60 : 0;
  const text = new Date(Math.round((t_s + shift_s) * 1000)).toISOString();
  return { date: text.slice(0, 10), clock: text.slice(11, 19), fraction: text.slice(19, 23) };
}

/** `12:40`, `3:05:09`, `37 d 03:05:09` would never be needed: hours go on counting. */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "";
  const whole = Math.round(Math.abs(seconds));
  const [hours, minutes, rest] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  return `${seconds < 0 && whole ? "-" : ""}${hours ? `${hours}:${two(minutes)}` : minutes}:${two(rest)}`;
}

/** `2026-11-20 18:45:50Z`, with +09:00 in local form, or the time elapsed since the start of the run. */
export function stamp(t_s, started_s = null) {
  if (t_s === null || t_s === undefined || !Number.isFinite(t_s)) return "";
  if (timeForm() === "elapsed" && started_s !== null) return `+${duration(t_s - started_s)}`;
  const { date, clock } = parts(t_s);
  return `${date} ${clock}${zone(t_s)}`;
}

/** As `stamp` without the date. */
export function clock(t_s, started_s = null) {
  if (timeForm() === "elapsed" && started_s !== null) return stamp(t_s, started_s);
  return t_s === null || t_s === undefined ? "" : `${parts(t_s).clock}${zone(t_s)}`;
}

const STEPS_s = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200,
  86400, 172800, 432000, 864000];

/**
 * Ticks of a time axis: [[t_s, label], ...], round in the form of time that is shown. The date stands at the first tick and at midnight.
 * Args: first_s, last_s: what the axis shows; most: how many ticks there is room for; started_s: zero of elapsed time.
 */
export function timeTicks(first_s, last_s, most, started_s) {
  const step = STEPS_s.find((one) => (last_s - first_s) / one <= most) ?? 864000;
  const elapsed = timeForm() === "elapsed" && started_s !== null;
  const zero = elapsed ? started_s : timeForm() === "local" ? -offsetMinutes(first_s) * 60 : 0;
  const ticks = [];
  let day = "";
  for (let n = Math.ceil((first_s - zero) / step - 1e-9); zero + n * step <= last_s + 1e-9 && ticks.length < 100; n += 1) {
    const t_s = zero + n * step;
    if (elapsed) { ticks.push([t_s, step < 1 ? (n * step).toFixed(2) : duration(n * step)]); continue; }
    const { date, clock: time, fraction } = parts(t_s);
    const label = step < 1 ? time + fraction.slice(0, step < 0.1 ? 3 : 2) : step < 60 ? time : time.slice(0, 5);
    ticks.push([t_s, date === day ? label : `${label}\n${date}`]);
    day = date;
  }
  return ticks;
}

/** What the axis counts in. */
export function axisName(t_s, names) {
  const form = timeForm();
  return form === "local" ? `${names.local} ${zone(t_s)}` : names[form];
}

// Conditions of a step, record or estimate in short: what a technician asks for first, in words of the field.

const SILENT = new Set(["temperature_degC", "channel", "route", "current_A", "polarity", "branch", "kind", "level_A", "level_index", "range_A",
  "purpose", "settle_band_degC", "repeat"]);
const PREFIXES = [[1, "A"], [1e-3, "mA"], [1e-6, "\u00b5A"], [1e-9, "nA"]];

/** Ampere of a unit of current as the page writes it; undefined for another unit. */
export const inAmpere = (unit) => PREFIXES.find(([, name]) => name === unit)?.[0];

export function current(value_A, polarity) {
  const size = Math.abs(value_A);
  const [scale, unit] = PREFIXES.find(([one]) => size >= one * 0.9999) ?? PREFIXES.at(-1);
  const sign = value_A === 0 ? "" : (polarity ?? Math.sign(value_A)) < 0 ? "\u2212" : "+";
  return `${sign}${Number((size / scale).toPrecision(6))} ${unit}`;
}

const plain = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(6))) : Array.isArray(value) ? value.join(", ") : typeof value === "object" && value !== null ? JSON.stringify(value) : String(value));

/** Temperature, channel, current and branch first; what else there is by its name. */
export function conditions(values) {
  if (!values || typeof values !== "object") return values ?? "";
  const words = [];
  if (Number.isFinite(values.temperature_degC)) words.push(`${Number(values.temperature_degC.toPrecision(6))} \u00b0C`.replace("-", "\u2212"));
  if ("channel" in values) words.push(t("conditions.channel", { channel: values.channel }));
  if (values.kind) words.push(values.kind);
  if (values.route === "open") words.push(t("conditions.open"));
  else if (Number.isFinite(values.current_A)) words.push(current(values.current_A, values.polarity));
  if (values.branch) words.push(plain(values.branch));
  for (const [name, value] of Object.entries(values)) if (!SILENT.has(name) && value !== null) words.push(`${name} ${plain(value)}`);
  return words.join(", ");
}

// The state of the bench: what is on, since when that is known, what stays dangerous. Never a word that it may be touched.

const SHOWN_PLAIN = new Set(["current", "voltage", "frequency", "amplitude", "mode"]);
const ORDER = ["table", "source", "supply", "chamber", "signal", "switch", "unknown"];

/** A value with its unit as people write it: "24.8 °C", "20 mA". */
function written(text) {
  const [value, ...unit] = text.split(" ");
  return unit.length ? `${value.replace("-", "\u2212")} ${unitText(unit.join(" "))}` : text;
}

function figures(part) {
  return part.figures.map(({ name, text }) => (SHOWN_PLAIN.has(name) ? written(text) : `${word("bench.figure", name)} ${written(text)}`)).join(", ");
}

/** Who has not confirmed it, as the bench names them; "all" while a guard has not said of whom. */
export const unconfirmedText = (what) => t("bench.unconfirmed", { what: what === "all" ? t("bench.every-instrument") : what });

/** What a guard that acted has to say beside its confirmation: that it is at it, goes on trying, or who took the bench over. */
function guardText(guard) {
  if (!guard || guard.safe) return "";
  if (guard.by) return t("bench.taken-over", { by: guard.by });
  return t(guard.safe === false ? "bench.guard-trying" : "bench.guard-acting", { time: guard.utc ? clock(Date.parse(guard.utc) / 1000) : "" });
}

/** What is not confirmed safe, what is on, and what is not known, one line each; nothing for what was confirmed off. */
function benchParts(bench, guard) {
  const sorted = [...(bench.parts ?? [])].sort((one, other) => ORDER.indexOf(one.kind) - ORDER.indexOf(other.kind));
  const left = bench.unconfirmed ?? {};
  const names = Object.entries(left).map(([role, state]) => (state ? `${role} (${state})` : role)).join(", ");
  const said = [names ? unconfirmedText(names) : "", guardText(guard)].filter(Boolean).map((text) => make("li", { class: "unknown" }, make("strong", {}, text)));
  const on = sorted.filter((part) => part.state === "on").map((part) => make("li", {}, make("strong", {}, part.role), ` ${figures(part)}`));
  const unknown = sorted.filter((part) => part.state === "unknown" && !(part.role in left)).map((part) => make("li", { class: "unknown" }, make("strong", {}, part.role),
    ` ${t("bench.part-unknown")}`));
  return [...said, ...on, ...unknown];
}

function since(bench, now_s, guard) {
  if (bench.confirmed_utc_s === null || bench.confirmed_utc_s === undefined) return "";
  if (guard?.safe) return t("bench.by-guard", { time: clock(bench.confirmed_utc_s) });
  if (bench.ended_utc_s) return t("bench.at-end", { time: clock(bench.confirmed_utc_s) });
  const age_s = Math.max(0, now_s - bench.confirmed_utc_s);
  return t("bench.confirmed", { age: age_s < 90 ? `${Math.round(age_s)} s` : duration(age_s) });
}

/**
 * The word for now. `heard`: the run or its server answers; else nothing is known, whatever was heard last.
 * bench: as in the state document.
 */
const benchWord = (bench, heard) => (heard && bench ? bench.state : "unknown");

/** Fills an element with the state: word, confirmation, what is on, what remains. */
export function showBench(element, bench, { heard, now_s, guard = null, replay = false }) {
  const state = benchWord(bench, heard);
  const mark = JSON.stringify([state, heard, replay, bench, guard, Math.round(now_s), document.documentElement.lang]);
  if (element.dataset.mark === mark) return;
  element.dataset.mark = mark;
  element.dataset.state = state;
  const old = bench && state === "unknown" && heard === false;
  const said = old ? t("bench.unheard") : bench ? since(bench, now_s, guard) : "";
  const remains = (bench?.remains ?? ["mains"]).map((name) => word("bench.remains", name)).join(", ");
  element.replaceChildren(
    make("p", { class: "bench-word" }, icon(`bench-${state}`), make("strong", {}, t(`bench.${state}`)), make("span", { class: "soft" }, said)),
    make("ul", { class: "bench-parts" }, ...(old || !bench ? [] : benchParts(bench, guard))),
    make("p", { class: "bench-remains soft" }, t("bench.remains", { what: remains })),
  );
}
