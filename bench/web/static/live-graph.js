// The figures of the last minute, what of a graph may be shown, and questions to the history.
import { draw, make, remember, remembered, say, t, unitText } from "./base.js";
import { minus } from "./figure.js";
import { choiceOf, GraphCard } from "./graph-card.js";
import { bucketAt, joined, pick, readHistory } from "./points.js";
import { isReplay, page } from "./state.js";
import { current, duration, inAmpere } from "./words.js";

// What a graph window may show: rates where its signals are counts, in the unit the campaign gives them, and the counts as they came.

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
function againstSet(view, rows, last_s) {
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

// Questions to the history of a run: the newest one counts, an older one is given up.

export class History {
  #asking = null;
  trouble = ""; // what the server said when it could not answer

  /**
   * Rows between two instants with at most n buckets, or null: a newer question took its place, or `trouble` says why.
   * Args: signals: names, and factors of their values if any; t0_s, t1_s: seconds since 1970; n: buckets.
   */
  async ask({ signals, factors = null }, t0_s, t1_s, n) {
    this.#asking?.abort();
    const asking = new AbortController();
    this.#asking = asking;
    const query = new URLSearchParams({ signals: signals.join(","), t0: t0_s, t1: t1_s, n: Math.round(n) });
    try {
      const reply = await fetch(`/api/v1/runs/${encodeURIComponent(page.run)}/history?${query}`, { signal: asking.signal });
      if (reply.ok) {
        this.trouble = "";
        const rows = readHistory(await reply.arrayBuffer());
        return factors ? pick(rows, signals.map((_, column) => column), factors) : rows;
      }
      this.trouble = (await reply.json().catch(() => ({}))).text ?? `HTTP ${reply.status}`;
      return null;
    } catch {
      return null; // given up, or the server is gone: what is drawn stays, and the head of the page says how old it is
    } finally {
      if (this.#asking === asking) this.#asking = null;
    }
  }

  get busy() { return this.#asking !== null; }
}

/** First and last instant of the run, seconds since 1970. */
export function runSpan(newest_s) {
  const { state } = page;
  const first_s = state.replay?.first_utc_s ?? state.started_utc_s;
  const last_s = state.replay?.last_utc_s ?? Math.max(newest_s || -Infinity, state.t_utc_s ?? -Infinity);
  return { first_s, last_s: Math.max(last_s, first_s + 1) };
}

// A graph that follows the run: the last minute from the points themselves, longer windows from the history with the points behind.

const MINUTE_s = 60;
const WHOLE_RUN = 0;

export class LiveGraph {
  constructor(graph, number, look) {
    this.graph = graph;
    this.number = number;
    this.views = viewsOf(graph);
    [this.view] = this.views;
    this.history = new History();
    this.before = null; // rows of the history
    this.asked_ms = -Infinity;
    this.ring = null;
    this.card = new GraphCard(graph.title, this.view.curves, look);
    if (this.views.length > 1) {
      choiceOf(this.card.choices, this.views.map((view) => [view, t(`graph.${view.name}`)]), this.view, (view) => this.setView(view));
    }
    const windows = [...new Set([MINUTE_s, 600, 3600, Math.round(graph.window_s ?? MINUTE_s)])].sort((one, other) => one - other);
    this.window_s = Number(remembered(`window.${graph.title}`, graph.window_s ?? MINUTE_s));
    if (![...windows, WHOLE_RUN].includes(this.window_s)) this.window_s = windows[0];
    choiceOf(this.card.choices, [...windows.map((window) => [window, windowName(window)]), [WHOLE_RUN, t("graph.run")]], this.window_s,
      (window) => this.setWindow(window));
    this.lock = make("button", { type: "button", "aria-pressed": "false", title: t("graph.lock-title"), onclick: () => this.turnLock() }, t("graph.lock"));
    this.card.choices.append(this.lock);
    this.seen = true;
    new IntersectionObserver(([entry]) => { this.seen = entry.isIntersecting; }, { rootMargin: "300px" }).observe(this.card.element);
  }

  async draw(item) {
    await this.card.draw(item);
    this.card.figure.setUnit(this.view.unit);
    this.refresh();
  }

  setView(view) {
    this.view = view;
    this.card.setCurves(view.curves);
    this.card.figure?.setUnit(view.unit);
    this.forget();
    this.refresh();
  }

  setWindow(window_s) {
    this.window_s = window_s;
    remember(`window.${this.graph.title}`, window_s);
    this.forget();
    this.refresh();
  }

  /** What the history said is of another run or place. */
  forget() {
    this.before = null;
    this.asked_ms = -Infinity;
    if (this.card.figure) this.card.figure.fitted = false;
  }

  turnLock() {
    const locked = this.lock.getAttribute("aria-pressed") !== "true";
    this.lock.setAttribute("aria-pressed", String(locked));
    if (!locked) this.refresh();
  }

  points(ring) {
    this.ring = ring;
    if (this.seen) this.refresh(); // once a second is enough for a graph nobody has scrolled to
  }

  refresh = () => { draw(this.paint); };

  span() {
    const last_s = this.ring?.count ? this.ring.last_s : page.t_s || page.state.t_utc_s;
    const first_s = this.window_s === WHOLE_RUN ? runSpan(last_s).first_s : last_s - this.window_s;
    return { first_s, last_s };
  }

  paint = () => {
    const { figure } = this.card;
    if (!figure || !this.ring) return;
    const { first_s, last_s } = this.span();
    const { factors, least, mean_s, signals } = this.view;
    const columns = signals.map((name) => page.state.signals.findIndex((signal) => signal.name === name));
    const live = this.ring.since(-Infinity);
    let rows = pick(live, columns, factors);
    if (this.window_s !== MINUTE_s) {
      this.ask(first_s, last_s);
      if (this.before) rows = behind(this.before, this.ring, columns, factors);
    }
    figure.show(rows, first_s, last_s, { lockY: this.lock.getAttribute("aria-pressed") === "true", decimals: this.card.curves[0]?.decimals, least });
    say(this.card.bucket, bucketText(this.before && this.window_s !== MINUTE_s ? this.before.bucket_s : this.ring.width_s, mean_s));
    say(this.card.at, factors ? againstSet(this.view, rows, last_s) : "");
  };

  /** Asks again when the window has moved by a hundredth, and not more than once a second. */
  async ask(first_s, last_s) {
    const now = performance.now();
    const stale = !this.before || last_s - this.before.to_s > Math.min(30, Math.max(5, (last_s - first_s) / 100)) || last_s < this.before.to_s - 1;
    if (!stale || this.history.busy || now - this.asked_ms < 1000) return;
    this.asked_ms = now;
    const { view } = this;
    const rows = await this.history.ask(view, first_s, last_s, Math.max(300, this.card.plot.clientWidth));
    this.card.complain(this.history.trouble);
    if (rows && view === this.view) { this.before = Object.assign(rows, { to_s: last_s }); this.refresh(); }
    else this.asked_ms += 4000; // no answer: not again at once
  }

  each_second() {
    this.card.tabulate();
    if (isReplay() || !this.seen || this.window_s !== MINUTE_s) this.refresh();
  }
}

/** Rows of the history and the points that came after them, parted where there is nothing between. */
function behind(before, ring, columns, factors) {
  const last_s = before.n ? before.t_s[before.n - 1] : -Infinity;
  const live = pick(ring.since(last_s + before.bucket_s), columns, factors);
  if (!live.n || !before.n || live.t_s[0] - last_s <= 2.5 * Math.max(before.bucket_s, 0.4)) return joined(before, live);
  const gap = { n: 1, signals: before.signals, bucket_s: 0, t_s: Float64Array.of(last_s + before.bucket_s), pairs: new Float32Array(before.signals * 2).fill(NaN) };
  return joined(joined(before, gap), live);
}

function windowName(window_s) {
  if (window_s % 3600 === 0) return t("graph.hours", { n: window_s / 3600 });
  return window_s % 60 === 0 ? t("graph.minutes", { n: window_s / 60 }) : duration(window_s);
}
