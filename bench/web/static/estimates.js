// Results so far: a table, for each a small curve of how it has settled, and the one that is chosen large, against its limit.
import { conditions } from "./conditions.js";
import { byId, fillTable, make, say } from "./dom.js";
import { estimateFigure, usedShare } from "./estimate-figure.js";
import { minus } from "./figure.js";
import { page } from "./state.js";
import { t, word } from "./texts.js";
import { stamp } from "./time.js";
import { unitText } from "./units.js";

const SVG = "http://www.w3.org/2000/svg";
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
export function withUncertainty(value, uncertainty) {
  if (!Number.isFinite(value)) return ["", ""];
  if (!(uncertainty > 0)) return [minus(value.toPrecision(6)), ""];
  const size = Math.floor(Math.log10(Math.max(Math.abs(value), uncertainty)));
  const power = Math.abs(size) > 4 ? Math.floor(size / 3) * 3 : 0;
  const scale = 10 ** power;
  const places = Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(uncertainty / scale))));
  const tail = power ? `e${power}` : "";
  return [minus((value / scale).toFixed(places) + tail), minus((uncertainty / scale).toFixed(places) + tail)];
}

/** The limit of a result: one number on both sides of zero, or low and high. */
function limitText({ limit = null, limits = null }) {
  if (limits === null) return limit === null ? "" : `\u00b1${limit}`;
  const { low = null, high = null } = limits;
  if (low !== null && high !== null) return `${minus(String(low))} \u2026 ${minus(String(high))}`;
  return low === null ? `\u2264 ${minus(String(high))}` : `\u2265 ${minus(String(low))}`;
}

const VERDICT_CLASS = { fail: "bad", conditional_fail: "bad", indeterminate: "warn" };

function cellOf(key, row) {
  const mark = JSON.stringify(row.history ?? []);
  const known = pictures.get(key);
  if (known?.mark === mark) return known.svg;
  const svg = picture(row.history ?? [], t("estimate.picture", { quantity: nameOf(row) }));
  pictures.set(key, { mark, svg });
  return svg;
}

const nameOf = (row) => row.title ?? row.quantity;
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
  const columns = [["quantity", "fixed"], ["conditions", ""], ["value", "number"], ["uncertainty", "number"], ["unit", "fixed"], ["limit", "number"], ["verdict", "fixed"], ["course", ""]]
    .map(([name, look]) => ({ head: t(`estimate.${name}`), class: look }));
  const keys = new Set();
  fillTable(byId("estimates"), columns, rows.map((row) => {
    const key = keyOf(row);
    keys.add(key);
    const [value, uncertainty] = withUncertainty(row.value, row.expanded_uncertainty ?? row.std_uncertainty);
    const claim = ["doubtful", "refused"].includes(row.quality) ? t(`quality.${row.quality}`) : uncertainty;
    return { key, class: VERDICT_CLASS[row.verdict] ?? "",
      cells: [names.get(key)?.text === nameOf(row) ? names.get(key).button : nameCell(row, key), conditions(row.conditions), value, claim, unitText(row.unit), limitText(row), row.verdict && row.verdict !== "none" ? word("verdict", row.verdict) : "", cellOf(key, row)] };
  }), estimates.why ?? t("estimate.none"));
  for (const kept of [pictures, names]) for (const key of [...kept.keys()]) if (!keys.has(key)) kept.delete(key);
  large(rows);
}
