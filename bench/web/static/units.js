// Units as people write them; the protocol has them in letters every keyboard knows.
const WRITTEN = { degC: "\u00b0C", "degC/min": "\u00b0C/min", uA: "\u00b5A", us: "\u00b5s", "ppm/degC": "ppm/\u00b0C", deg: "\u00b0" };

/** A text of the run with its units as people write them. */
export const inUnits = (text) => (text ?? "").replaceAll("degC", "\u00b0C");

export const unitText = (unit) => WRITTEN[unit] ?? (unit ?? "").replace("degC", "\u00b0C");
