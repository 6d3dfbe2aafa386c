// Points of signals: as they come, the newest ones, as curves, and the time that is looked at.

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

// The last minute of points: a fixed number of rows that never grows, whatever is sent.
const LIVE_ROWS = 600;

export class Ring {
  constructor(rows = LIVE_ROWS) {
    this.rows = rows;
    this.begin(0);
  }

  /** Forgets everything; from now on points have so many signals. */
  begin(signals) {
    this.signals = signals;
    this.t_s = new Float64Array(this.rows);
    this.pairs = new Float32Array(this.rows * signals * 2);
    this.count = 0;
    this.head = 0; // where the next row goes
    this.next = null; // number of the point that must come next
  }

  #row(t_s, pairs, at) {
    const width = this.signals * 2;
    this.t_s[this.head] = t_s;
    if (pairs) this.pairs.set(pairs.subarray(at * width, (at + 1) * width), this.head * width);
    else this.pairs.fill(NaN, this.head * width, (this.head + 1) * width);
    this.head = (this.head + 1) % this.rows;
    this.count = Math.min(this.count + 1, this.rows);
  }

  /** Takes a batch. False: points are missing before it that the server did not speak of, or it is of another shape. */
  add(batch) {
    if (!batch.n) return true;
    if (batch.signals !== this.signals) return false;
    const follows = this.next === null || batch.first === this.next;
    if (!follows && !(batch.flags & 1)) return false;
    if (!follows || (batch.flags & 1 && this.count)) this.#row(batch.t_s[0] - 0.001, null, 0);
    for (let row = 0; row < batch.n; row += 1) this.#row(batch.t_s[row], batch.pairs, row);
    this.next = (batch.first + batch.n) >>> 0;
    return true;
  }

  /** Width of a point, s: 0.1 of a living run, more of a recording that is played fast. */
  get width_s() {
    if (this.count < 2) return 0.1;
    const before_s = this.t_s[(this.head + this.rows - 2) % this.rows];
    return Math.max(0.1, Math.round((this.last_s - before_s) * 10) / 10);
  }

  get last_s() { return this.count ? this.t_s[(this.head + this.rows - 1) % this.rows] : NaN; }

  /** Rows later than an instant, oldest first, as a history answer has them. */
  since(after_s) {
    const width = this.signals * 2;
    const start = (this.head + this.rows - this.count) % this.rows;
    let skip = 0;
    while (skip < this.count && !(this.t_s[(start + skip) % this.rows] > after_s)) skip += 1;
    const n = this.count - skip;
    const found = { n, signals: this.signals, bucket_s: this.width_s, t_s: new Float64Array(n), pairs: new Float32Array(n * width) };
    for (let row = 0; row < n; row += 1) {
      const from = (start + skip + row) % this.rows;
      found.t_s[row] = this.t_s[from];
      found.pairs.set(this.pairs.subarray(from * width, (from + 1) * width), row * width);
    }
    return found;
  }
}

// From buckets of least and greatest values to what is drawn. Nothing is left out, nothing is bridged.

/**
 * The line of one signal through every bucket: up in one, down in the next, so that both ends of each are on it.
 * Args: rows: {n, signals, t_s, pairs}; column: number of the signal. Returns: {t (ms), y}; NaN parts the line.
 */
export function lineOf(rows, column) {
  const t = new Float64Array(rows.n * 2);
  const y = new Float64Array(rows.n * 2);
  let at = 0;
  for (let row = 0; row < rows.n; row += 1) {
    const low = rows.pairs[(row * rows.signals + column) * 2];
    const high = rows.pairs[(row * rows.signals + column) * 2 + 1];
    const t_ms = rows.t_s[row] * 1000;
    const up = row % 2 === 0;
    t[at] = t_ms; y[at] = up ? low : high; at += 1;
    if (low !== high) { t[at] = t_ms; y[at] = up ? high : low; at += 1; }
  }
  return { t: t.subarray(0, at), y: y.subarray(0, at) };
}

/**
 * As `lineOf`, every bucket a box as wide as it lasts: where a bucket is several pixels wide, a line through its ends would look like a wave.
 */
export function boxesOf(rows, column) {
  const t = new Float64Array(rows.n * 6);
  const y = new Float64Array(rows.n * 6);
  for (let row = 0; row < rows.n; row += 1) {
    const low = rows.pairs[(row * rows.signals + column) * 2];
    const high = rows.pairs[(row * rows.signals + column) * 2 + 1];
    const next_s = row + 1 < rows.n ? rows.t_s[row + 1] : Infinity;
    const [from, to] = [rows.t_s[row] * 1000, Math.min(rows.t_s[row] + rows.bucket_s, next_s) * 1000];
    t.set([from, from, to, to, from, to], row * 6);
    y.set([low, high, high, low, low, low], row * 6);
  }
  return { t, y };
}

/** Rows without any: of so many signals. */
export const nothing = (signals) => ({ n: 0, signals, bucket_s: 0, t_s: new Float64Array(0), pairs: new Float32Array(0) });

/** Some columns of rows as rows of their own, each times its factor. */
export function pick(rows, columns, factors = null) {
  const pairs = new Float32Array(rows.n * columns.length * 2);
  for (let row = 0; row < rows.n; row += 1) {
    columns.forEach((column, index) => {
      const from = (row * rows.signals + column) * 2;
      const to = (row * columns.length + index) * 2;
      const factor = column < 0 ? NaN : factors?.[index] ?? 1;
      pairs[to] = rows.pairs[from] * factor;
      pairs[to + 1] = rows.pairs[from + 1] * factor;
    });
  }
  return { n: rows.n, signals: columns.length, bucket_s: rows.bucket_s, t_s: rows.t_s, pairs };
}

/** One after the other; both have the same signals. */
export function joined(before, after) {
  const [t_s, pairs] = [new Float64Array(before.n + after.n), new Float32Array(before.pairs.length + after.pairs.length)];
  t_s.set(before.t_s); t_s.set(after.t_s, before.n);
  pairs.set(before.pairs); pairs.set(after.pairs, before.pairs.length);
  return { n: before.n + after.n, signals: before.signals, bucket_s: before.bucket_s, t_s, pairs };
}

/** Least and greatest of a column between two instants, its last bucket, and the mean of the middles of its buckets. */
export function extent(rows, column, first_s = -Infinity, last_s = Infinity) {
  let [low, high, sum, count] = [Infinity, -Infinity, 0, 0];
  let last = null;
  for (let row = 0; row < rows.n; row += 1) {
    if (rows.t_s[row] < first_s || rows.t_s[row] > last_s) continue;
    const a = rows.pairs[(row * rows.signals + column) * 2];
    const b = rows.pairs[(row * rows.signals + column) * 2 + 1];
    if (Number.isNaN(a) || Number.isNaN(b)) continue;
    low = Math.min(low, a); high = Math.max(high, b); sum += (a + b) / 2; count += 1;
    last = [a, b];
  }
  return count ? { low, high, mean: sum / count, last } : null;
}

/** The bucket of a column nearest before an instant, [low, high], or null where there is none. */
export function bucketAt(rows, column, t_s) {
  let [low, high] = [0, rows.n];
  while (low < high) { const middle = (low + high) >> 1; if (rows.t_s[middle] <= t_s) low = middle + 1; else high = middle; }
  if (!low) return null;
  const at = ((low - 1) * rows.signals + column) * 2;
  return Number.isNaN(rows.pairs[at]) ? null : [rows.pairs[at], rows.pairs[at + 1]];
}

/** Round ticks of an axis of values: {ticks, decimals}. */
export function valueTicks(low, high, most) {
  const rough = (high - low) / Math.max(1, most);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough * (1 - 1e-9));
  const ticks = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + step * 1e-9 && ticks.length < 50; n += 1) ticks.push(n * step);
  return { ticks, decimals: Math.min(12, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))) };
}

/** The longest beginning that all names share up to a dot or bracket, which a list of curves need not repeat. */
export function sharedPrefix(names) {
  if (names.length < 2) return (names[0] ?? "").slice(0, (names[0] ?? "").indexOf(".") + 1);
  let prefix = names[0];
  for (const name of names) while (!name.startsWith(prefix)) prefix = prefix.slice(0, -1);
  return prefix.slice(0, Math.max(prefix.lastIndexOf("."), prefix.lastIndexOf("[")) + 1);
}

// One cursor in all figures: where the pointer or the arrow keys stand, in seconds since 1970, or null.
const listeners = new Set();
export const cursor = { t_s: null };

export function onCursor(listener) { listeners.add(listener); }

export function moveCursor(t_s) {
  if (t_s === cursor.t_s) return;
  cursor.t_s = t_s;
  for (const listener of listeners) listener();
}
