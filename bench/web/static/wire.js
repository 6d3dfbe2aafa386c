// Binary messages of docs/live-protocol.md. Little endian, as every machine this page runs on.

/** A batch of points: {first, flags, t_s: Float64Array(n), pairs: Float32Array(n * signals * 2)}. Throws RangeError if it is torn. */
export function readBatch(buffer) {
  const head = new DataView(buffer);
  const [first, n, flags] = [head.getUint32(0, true), head.getUint16(4, true), head.getUint16(6, true)];
  const t_s = new Float64Array(buffer, 8, n);
  const pairs = new Float32Array(buffer, 8 + 8 * n);
  return { first, n, flags, t_s, pairs, signals: n ? pairs.length / (2 * n) : 0 };
}

/** An answer of the history endpoint: {n, signals, bucket_s, t_s, pairs}. Throws RangeError if it is torn. */
export function readHistory(buffer) {
  const head = new DataView(buffer);
  const [n, signals, bucket_s] = [head.getUint32(0, true), head.getUint32(4, true), head.getFloat64(8, true)];
  return { n, signals, bucket_s, t_s: new Float64Array(buffer, 16, n), pairs: new Float32Array(buffer, 16 + 8 * n, n * signals * 2) };
}

/** JSON merge patch, RFC 7386: a new document; null takes a key away. */
export function mergePatch(target, patch) {
  if (patch === null || typeof patch !== "object" || Array.isArray(patch)) return patch;
  const merged = target !== null && typeof target === "object" && !Array.isArray(target) ? { ...target } : {};
  for (const [key, value] of Object.entries(patch)) {
    if (value === null) delete merged[key];
    else merged[key] = mergePatch(merged[key], value);
  }
  return merged;
}
