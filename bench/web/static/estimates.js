// Results so far.
import { byId, fillTable, make, say, t, unitText, word } from "./base.js";
import { minus } from "./figure.js";
import { valueTicks } from "./points.js";
import { page } from "./state.js";
import { conditions, stamp } from "./words.js";

// One result against its limit: its course over the records with the band of its expanded uncertainty, and the lines it must stay within.

const SVG = "http://www.w3.org/2000/svg";
const [HIGH, LEFT, RIGHT, TOP, BOTTOM] = [210, 62, 12, 20, 40];

function draw(tag, properties, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(properties)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/** Low and high that a result must stay within, null where there is none. */
function boundsOf({ limit = null, limits = null }) {
  if (limits !== null) return [limits.low ?? null, limits.high ?? null];
  return limit === null ? [null, null] : [-limit, limit];
}

/** How much of the room to its limit a result has used, its uncertainty included; 0 without a limit. */
function usedShare(row) {
  const [low, high] = boundsOf(row);
  const half = (high ?? 0) - (low ?? 0);
  if (!half || !Number.isFinite(row.value)) return 0;
  const [middle, reach] = low !== null && high !== null ? [(low + high) / 2, half / 2] : [0, Math.abs(half)];
  return (Math.abs(row.value - middle) + (row.expanded_uncertainty ?? 0)) / reach;
}

/** Args: row of the estimates; unit as text; width in pixels. Returns an SVG; history rows are [records, value, u, U]. */
function estimateFigure(row, unit, width, description) {
  const right = Math.max(260, width);
  const end = right - RIGHT;
  const svg = draw("svg", { class: "estimate-figure", viewBox: `0 0 ${right} ${HIGH}`, role: "img", "aria-label": description });
  Object.assign(svg.style, { width: `${right}px`, height: `${HIGH}px` });
  const points = (row.history ?? []).filter(([records, value]) => Number.isFinite(records) && Number.isFinite(value))
    .map(([records, value, , expanded]) => [records, value, expanded ?? 0]);
  if (!points.length) return svg;
  const bounds = boundsOf(row).filter((one) => one !== null);
  const values = [...bounds, ...points.flatMap(([, value, expanded]) => [value - expanded, value + expanded])];
  const pad = (Math.max(...values) - Math.min(...values)) * 0.08 || Math.abs(values[0]) * 0.01 || 1;
  const [low, high] = [Math.min(...values) - pad, Math.max(...values) + pad];
  const [first, last] = [points[0][0], points.at(-1)[0]];
  const x = (records) => LEFT + (last > first ? (records - first) / (last - first) : 0.5) * (end - LEFT);
  const y = (value) => HIGH - BOTTOM - ((value - low) / (high - low)) * (HIGH - TOP - BOTTOM);
  const { ticks, decimals } = valueTicks(low, high, 5);
  for (const tick of ticks) {
    svg.append(draw("line", { class: "grid", x1: LEFT, x2: end, y1: y(tick), y2: y(tick) }),
      draw("text", { x: LEFT - 6, y: y(tick) + 4, "text-anchor": "end" }, minus(tick.toFixed(decimals))));
  }
  for (const bound of bounds) {
    svg.append(draw("line", { class: "limit", x1: LEFT, x2: end, y1: y(bound), y2: y(bound) }),
      draw("text", { class: "limit", x: end, y: y(bound) + (y(bound) < TOP + 14 ? 13 : -4), "text-anchor": "end" },
        t("estimate.limit-line", { value: minus(String(bound)), unit })));
  }
  svg.append(...course(points, x, y), draw("text", { x: LEFT, y: HIGH - 20 }, String(first)),
    draw("text", { x: end, y: HIGH - 20, "text-anchor": "end" }, last > first ? String(last) : ""),
    draw("text", { x: (LEFT + end) / 2, y: HIGH - 4, "text-anchor": "middle" }, t("estimate.records-axis")),
    draw("text", { x: 4, y: 12 }, unit));
  return svg;
}

/** Band of U and line of the values; a single result is a dot with its bar. */
function course(points, x, y) {
  if (points.length === 1) {
    const [[records, value, expanded]] = points;
    return [draw("line", { class: "bar", x1: x(records), x2: x(records), y1: y(value - expanded), y2: y(value + expanded) }),
      draw("circle", { cx: x(records), cy: y(value), r: 4 })];
  }
  const edge = (sign) => points.map(([records, value, expanded]) => `${x(records)},${y(value + sign * expanded)}`);
  return [draw("polygon", { points: [...edge(1), ...edge(-1).toReversed()].join(" ") }),
    draw("polyline", { points: points.map(([records, value]) => `${x(records)},${y(value)}`).join(" ") })];
}

// Results so far: a table, for each a small curve of how it has settled, and the one that is chosen large, against its limit.

const [WIDTH, HEIGHT] = [144, 35];
const pictures = new Map();
let shown; // estimates of the last time
let chosen = null; // key of the result that somebody has chosen; null: the one nearest to its limit
let drawn = null; // what the large figure shows

/** Value over number of records, with a band of one standard uncertainty. */
function picture(history, description) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("class", "spark");
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", description);
  const rows = history.map((row) => row.slice(0, 3)).filter((row) => row.every(Number.isFinite));
  if (rows.length < 2) return svg;
  const [first, last] = [rows[0][0], rows.at(-1)[0]];
  const [low, high] = [Math.min(...rows.map((row) => row[1] - row[2])), Math.max(...rows.map((row) => row[1] + row[2]))];
  const x = (records) => (((records - first) / (last - first || 1)) * WIDTH).toFixed(1);
  const y = (value) => (HEIGHT - 2 - ((value - low) / (high - low || 1)) * (HEIGHT - 4)).toFixed(1);
  const band = document.createElementNS(SVG, "polygon");
  band.setAttribute("points", [...rows.map((row) => `${x(row[0])},${y(row[1] + row[2])}`),
    ...rows.toReversed().map((row) => `${x(row[0])},${y(row[1] - row[2])}`)].join(" "));
  const line = document.createElementNS(SVG, "path");
  line.setAttribute("d", rows.map((row, index) => `${index ? "L" : "M"}${x(row[0])} ${y(row[1])}`).join(""));
  svg.append(band, line);
  return svg;
}

/** As many digits as the uncertainty gives a meaning to: two of it. */
function withUncertainty(value, uncertainty) {
  if (!Number.isFinite(value)) return ["", ""];
  if (!(uncertainty > 0)) return [minus(value.toPrecision(6)), ""];
  const size = Math.floor(Math.log10(Math.max(Math.abs(value), uncertainty)));
  const power = Math.abs(size) > 4 ? Math.floor(size / 3) * 3 : 0;
  const scale = 10 ** power;
  const places = Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(uncertainty / scale))));
  const tail = power ? `e${power}` : "";
  return [minus((value / scale).toFixed(places) + tail), minus((uncertainty / scale).toFixed(places) + tail)];
}

const twoDigits = (uncertainty) => withUncertainty(uncertainty, uncertainty)[1];

/** The limit of a result: one number on both sides of zero, or low and high. */
function limitText({ limit = null, limits = null }) {
  if (limits === null) return limit === null ? "" : `\u00b1${limit}`;
  const { low = null, high = null } = limits;
  if (low !== null && high !== null) return `${minus(String(low))} \u2026 ${minus(String(high))}`;
  return low === null ? `\u2264 ${minus(String(high))}` : `\u2265 ${minus(String(low))}`;
}

const VERDICT_CLASS = { fail: "bad", indeterminate: "warn", conditional_fail: "bad", conditional_pass: "warn" };

function cellOf(key, row) {
  const mark = JSON.stringify(row.history ?? []);
  const known = pictures.get(key);
  if (known?.mark === mark) return known.svg;
  const svg = picture(row.history ?? [], t("estimate.picture", { quantity: nameOf(row) }));
  pictures.set(key, { mark, svg });
  return svg;
}

const nameOf = (row) => row.titles?.[document.documentElement.lang] ?? row.titles?.en ?? row.quantity;
const keyOf = (row) => `${row.quantity} ${JSON.stringify(row.conditions)}`;

/** Name of a quantity, its name in files as tooltip; pressed it is drawn large. */
function nameCell(row, key) {
  const button = make("button", { type: "button", class: "quantity", title: row.quantity, onclick: () => { chosen = key; large(shown?.rows ?? []); } }, nameOf(row));
  names.set(key, { button, text: nameOf(row) });
  return button;
}
const names = new Map();

/** The large figure: the result chosen, or the one that has used most of its room to the limit. */
function large(rows) {
  const known = rows.find((row) => keyOf(row) === chosen) ?? rows.reduce((worst, row) => (!worst || usedShare(row) > usedShare(worst) ? row : worst), null);
  const width = Math.min(1000, byId("estimates-card").clientWidth - 30);
  const key = known && JSON.stringify([keyOf(known), known.history, known.limit, known.limits, width]);
  for (const [name, { button }] of names) button.setAttribute("aria-pressed", String(Boolean(known) && name === keyOf(known)));
  if (key === drawn) return;
  drawn = key;
  const title = known ? [nameOf(known), conditions(known.conditions)].filter(Boolean).join(", ") : "";
  byId("estimate-figure").hidden = !known?.history?.some(([, value]) => Number.isFinite(value));
  byId("estimate-figure").replaceChildren(...(known ? [make("figcaption", {}, title), estimateFigure(known, unitText(known.unit), width, t("estimate.large", { quantity: title }))] : []));
}

export function showEstimates(everything = false) {
  const { estimates = null } = page.state;
  if (shown !== undefined && estimates === shown && !everything) {
    if (estimates) large(estimates.rows ?? []); // the width of the page may be another one
    return;
  }
  shown = estimates ?? null;
  const rows = estimates?.rows ?? [];
  const doubt = estimates?.doubt ?? [];
  byId("estimates-doubt").hidden = !doubt.length;
  say(byId("estimates-doubt"), doubt.join("\n"));
  byId("estimates-card").hidden = !estimates;
  if (!estimates) return;
  const when = stamp(estimates.t_utc_s, page.state.started_utc_s);
  say(byId("estimates-when"), t(estimates.final ? "estimate.of-session" : "estimate.when", { time: when, records: estimates.records ?? "\u2013" }));
  const foreseen = rows.some((row) => row.predicted_uncertainty);
  byId("estimates-foreseen").hidden = !foreseen;
  const claims = foreseen ? ["now", "end", "predicted"] : ["uncertainty"];
  const columns = [["quantity", "fixed"], ["conditions", ""], ["value", "number"], ...claims.map((name) => [name, "number"]), ["unit", "fixed"], ["limit", "number"], ["verdict", "fixed"], ["course", ""]]
    .map(([name, look]) => ({ head: t(`estimate.${name}`), class: look }));
  const keys = new Set();
  fillTable(byId("estimates"), columns, rows.map((row) => {
    const key = keyOf(row);
    keys.add(key);
    const [value, uncertainty] = withUncertainty(row.value, row.expanded_uncertainty ?? row.std_uncertainty);
    const claim = ["doubtful", "refused"].includes(row.quality) ? t(`quality.${row.quality}`) : uncertainty;
    return { key, class: VERDICT_CLASS[row.verdict] ?? "",
      cells: [names.get(key)?.text === nameOf(row) ? names.get(key).button : nameCell(row, key), conditions(row.conditions), value, claim, ...(foreseen ? [row.expected_uncertainty, row.predicted_uncertainty].map(twoDigits) : []), unitText(row.unit), limitText(row), row.verdict && row.verdict !== "none" ? word("verdict", row.verdict) : "", cellOf(key, row)] };
  }), estimates.why ?? t("estimate.none"));
  for (const kept of [pictures, names]) for (const key of [...kept.keys()]) if (!keys.has(key)) kept.delete(key);
  large(rows);
}
