// The last minute of points: a fixed number of rows that never grows, whatever is sent.
export const LIVE_ROWS = 600;

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
