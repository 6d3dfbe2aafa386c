// One result against its limit: its course over the records with the band of its expanded uncertainty, and the lines it must stay within.
import { valueTicks } from "./curves.js";
import { minus } from "./figure.js";
import { t } from "./texts.js";

const SVG = "http://www.w3.org/2000/svg";
const [HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [210, 62, 12, 20, 40];

function draw(tag, properties, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(properties)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/** Low and high that a result must stay within, null where there is none. */
export function boundsOf({ limit = null, limits = null }) {
  if (limits !== null) return [limits.low ?? null, limits.high ?? null];
  return limit === null ? [null, null] : [-limit, limit];
}

/** How much of the room to its limit a result has used, its uncertainty included; 0 without a limit. */
export function usedShare(row) {
  const [low, high] = boundsOf(row);
  const half = (high ?? 0) - (low ?? 0);
  if (!half || !Number.isFinite(row.value)) return 0;
  const [middle, reach] = low !== null && high !== null ? [(low + high) / 2, half / 2] : [0, Math.abs(half)];
  return (Math.abs(row.value - middle) + (row.expanded_uncertainty ?? 0)) / reach;
}

/** Args: row of the estimates; unit as text; width in pixels. Returns an SVG; history rows are [records, value, u, U]. */
export function estimateFigure(row, unit, width, description) {
  const right = Math.max(260, width);
  const end = right - RIGHT;
  const svg = draw("svg", { class: "estimate-figure", viewBox: `0 0 ${right} ${HEIGHT}`, role: "img", "aria-label": description });
  Object.assign(svg.style, { width: `${right}px`, height: `${HEIGHT}px` });
  const points = (row.history ?? []).filter(([records, value]) => Number.isFinite(records) && Number.isFinite(value))
    .map(([records, value, , expanded]) => [records, value, expanded ?? 0]);
  if (!points.length) return svg;
  const bounds = boundsOf(row).filter((one) => one !== null);
  const values = [...bounds, ...points.flatMap(([, value, expanded]) => [value - expanded, value + expanded])];
  const pad = (Math.max(...values) - Math.min(...values)) * 0.08 || Math.abs(values[0]) * 0.01 || 1;
  const [low, high] = [Math.min(...values) - pad, Math.max(...values) + pad];
  const [first, last] = [points[0][0], points.at(-1)[0]];
  const x = (records) => LEFT + (last > first ? (records - first) / (last - first) : 0.5) * (end - LEFT);
  const y = (value) => HEIGHT - BOTTOM - ((value - low) / (high - low)) * (HEIGHT - TOP - BOTTOM);
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
  svg.append(...course(points, x, y), draw("text", { x: LEFT, y: HEIGHT - 20 }, String(first)),
    draw("text", { x: end, y: HEIGHT - 20, "text-anchor": "end" }, last > first ? String(last) : ""),
    draw("text", { x: (LEFT + end) / 2, y: HEIGHT - 4, "text-anchor": "middle" }, t("estimate.records-axis")),
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
