// The state of the bench: what is on, since when that is known, what stays dangerous. Never a word that it may be touched.
import { icon, make } from "./dom.js";
import { t, word } from "./texts.js";
import { clock, duration } from "./time.js";
import { unitText } from "./units.js";

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

/** What is on, and what is not known, one line each; nothing for what was confirmed off. */
function parts(bench) {
  const sorted = [...(bench.parts ?? [])].sort((one, other) => ORDER.indexOf(one.kind) - ORDER.indexOf(other.kind));
  const on = sorted.filter((part) => part.state === "on").map((part) => make("li", {}, make("strong", {}, part.role), ` ${figures(part)}`));
  const unknown = sorted.filter((part) => part.state === "unknown").map((part) => make("li", { class: "unknown" }, make("strong", {}, part.role),
    ` ${t("bench.part-unknown")}`));
  return [...on, ...unknown];
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
export const benchWord = (bench, heard) => (heard && bench ? bench.state : "unknown");

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
    make("ul", { class: "bench-parts" }, ...(old || !bench ? [] : parts(bench))),
    make("p", { class: "bench-remains soft" }, t("bench.remains", { what: remains })),
  );
}
