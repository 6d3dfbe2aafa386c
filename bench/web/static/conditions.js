// Conditions of a step, record or estimate in short: what a technician asks for first, in words of the field.
import { t } from "./texts.js";

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
