// What a graph window may show: rates where its signals are counts, in the unit the campaign gives them, and the counts as they came.
import { current, inAmpere } from "./conditions.js";
import { bucketAt } from "./curves.js";
import { minus } from "./figure.js";
import { page } from "./state.js";
import { t } from "./texts.js";
import { unitText } from "./units.js";

const BENCH = "bench.";
const STEPS = 20; // an axis of rates is at least as high as so many counts: the steps of one count are no signal

/** A graph of temperatures of the bench alone: they have a figure of their own. */
export const isOfBench = (graph) => graph.signals.every((name) => name.startsWith(BENCH));

/** Views of a graph, the one shown first in front: [{name, signals, factors, unit, mean_s, least, curves}]; mean_s is 0 for readings. */
export function viewsOf(graph) {
  const { rates = null } = graph;
  const counts = viewOf(rates ? "counts" : "readings", graph.signals, { unit: graph.unit });
  return rates ? [viewOf("rates", rates.signals, rates), counts] : [counts];
}

function viewOf(name, signals, { unit, factors = null, decimals = null, mean_s = 0 }) {
  const known = signals.map((one) => page.state.signals.find((signal) => signal.name === one));
  const kinds = new Set(known.map((signal) => signal?.channel?.kind).filter(Boolean));
  const curves = signals.map((one, index) => ({
    name: one, channel: known[index]?.channel?.number, label: labelOf(known[index]?.channel, kinds.size > 1), unit: unitText(unit), decimals: decimals ?? known[index]?.decimals ?? 3 }));
  const least = factors ? STEPS * Math.max(...factors) / mean_s : 0;
  return { name, signals, factors, unit: unitText(unit), mean_s, least, curves };
}

/** The channel of the unit that a signal counts, with its kind where a graph has several; undefined for other signals. */
function labelOf(channel, withKind) {
  if (!channel) return undefined;
  return withKind && channel.kind ? t("graph.channel-kind", channel) : t("graph.channel", channel);
}

/** How far the channel that is driven now is from the level it is set to; empty where none is, or the unit is no current. */
export function againstSet(view, rows, last_s) {
  const { channel, current_A = null, polarity = 1, route } = page.state.step?.conditions ?? {};
  const index = view.curves.findIndex((curve) => curve.channel === channel);
  const one_A = inAmpere(view.unit);
  if (!one_A || index < 0 || !current_A || route === "open") return "";
  const bucket = bucketAt(rows, index, last_s);
  if (!bucket) return "";
  const set = (Math.abs(current_A) * Math.sign(polarity)) / one_A;
  const ppm = (value) => minus((value * 1e6).toFixed(0));
  return t("graph.against-set", { channel, level: current(current_A, polarity), ppm: ppm((bucket[0] + bucket[1]) / 2 / set - 1),
    count: ppm(view.factors[index] / view.mean_s / Math.abs(set)) });
}

/** Says over what a value is taken, so that nobody takes what is drawn for a reading. */
export function bucketText(bucket_s, mean_s = 0) {
  const bucket = seconds(bucket_s);
  if (!mean_s) return bucket_s ? t("graph.bucket", { bucket }) : t("graph.raw");
  const mean = t("graph.mean-over", { mean: seconds(mean_s) });
  return bucket_s > mean_s ? `${mean}; ${t("graph.bucket", { bucket })}` : mean;
}

const seconds = (value_s) => `${value_s.toFixed(value_s < 10 ? 1 : 0).replace(/\.0$/, "")} s`;
