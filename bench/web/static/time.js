// Times as people read them. Everything inside is seconds since 1970, UTC; only here they become text.
import { timeForm } from "./settings.js";

const two = (number) => String(number).padStart(2, "0");

/** Offset of local time at that instant in minutes east of UTC. */
export const offsetMinutes = (t_s) => -new Date(t_s * 1000).getTimezoneOffset();

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
