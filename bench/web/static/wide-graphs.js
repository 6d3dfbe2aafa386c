// The two figures of the whole run: temperature planned and actual, and the history that can be zoomed to single readings.
import { draw, make, say, t, word } from "./base.js";
import { minus } from "./figure.js";
import { choiceOf, GraphCard } from "./graph-card.js";
import { bucketText, History, runSpan, viewsOf } from "./live-graph.js";
import { extent, nothing } from "./points.js";
import { page } from "./state.js";
import { stamp } from "./words.js";

const TEMPERATURES = ["bench.air", "bench.unit"];
const WHOLE_RUN = 0;
const NARROW_px = 600; // a plot where the names of limits would cover each other
const NEAR_degC = 10;
const EVERY_ms = 15_000;
const ASK_AFTER_ms = 120; // a wheel turns many times; the last turn is asked for

export class TemperatureGraph {
  constructor(look, wide) {
    this.history = new History();
    this.asked_ms = -Infinity;
    this.rows = null;
    const curves = ["planned", "air", "unit"].map((name, index) => ({
      name: ["bench.setpoint", ...TEMPERATURES][index], label: t(`temperature.${name}`), unit: "\u00b0C", decimals: 2, style: index ? index - 1 : "soft" }));
    this.card = new GraphCard(t("temperature.title"), curves, look, { wide });
    this.window_s = WHOLE_RUN;
    choiceOf(this.card.choices, [[600, t("graph.minutes", { n: 10 })], [3600, t("graph.hours", { n: 1 })], [WHOLE_RUN, t("graph.run")]], WHOLE_RUN,
      (window_s) => { this.window_s = window_s; this.card.figure.fitted = false; this.forget(); this.each_second(); });
  }

  async draw(item) {
    await this.card.draw(item);
    this.each_second();
  }

  forget() { this.rows = null; this.asked_ms = -Infinity; }

  each_second() {
    this.card.tabulate();
    draw(this.paint);
    if (performance.now() - this.asked_ms > EVERY_ms && !this.history.busy && page.connected) this.ask();
  }

  async ask() {
    const { state } = page;
    const names = TEMPERATURES.filter((name) => (state.signals ?? []).some((signal) => signal.name === name));
    if (!names.length || !state.started_utc_s) return;
    this.asked_ms = performance.now();
    const { first_s, last_s } = this.span();
    const rows = await this.history.ask({ signals: names }, first_s, last_s, 1000);
    this.card.complain(this.history.trouble);
    if (rows) { this.rows = spread(rows, names); draw(this.paint); }
  }

  /** What is asked for: the run so far, or what came before the cursor of a recording, or now. */
  span() {
    const run = runSpan(page.t_s);
    if (this.window_s === WHOLE_RUN) return run;
    const last_s = page.state.replay?.at_utc_s ?? run.last_s;
    return { first_s: last_s - this.window_s, last_s };
  }

  paint = () => {
    const { figure } = this.card;
    const { state } = page;
    if (!figure || !state.started_utc_s) return;
    const { t_utc_s: plan_s = [], temperature_degC = [], bands = [] } = state.timetable ?? {};
    const whole = this.window_s === WHOLE_RUN;
    const { first_s, last_s } = this.span();
    const end_s = whole ? Math.max(last_s, plan_s.at(-1) ?? -Infinity) : last_s;
    const room = whole ? (end_s - first_s) * 0.01 : 0;
    const [start_ms, end_ms] = [(first_s - room) * 1000, (end_s + room) * 1000];
    const limits = limitLines(state.limits ?? []);
    const near = whole ? nearby(limits, [...temperature_degC, ...bands.flatMap((band) => band.slice(2)), ...(this.rows ? [1, 2].flatMap((index) => Object.values(extent(this.rows, index) ?? {}).filter(Number.isFinite)) : [])]) : [];
    const wide = this.card.plot.clientWidth > NARROW_px;
    const column = (index) => bands.map((band) => band[index] * (index < 2 ? 1000 : 1));
    figure.fill("bands", { t0: column(0), t1: column(1), low: column(2), high: column(3) });
    figure.fill("limits", { t0: limits.map(() => start_ms), t1: limits.map(() => end_ms), y: limits.map((one) => one.y),
      at: limits.map((_, index) => end_ms - (index % 3) * 0.33 * (end_ms - start_ms)), text: limits.map((one) => (wide ? one.text : "")) });
    say(this.card.at, [bands.length ? t("temperature.bands") : "", limits.length ? t("temperature.limits", { limits: limits.map((one) => one.text).join("; ") }) : ""]
      .filter(Boolean).join(" "));
    const line = whole ? { t: plan_s.map((t_s) => t_s * 1000), y: temperature_degC } : clipped(plan_s, temperature_degC, first_s, end_s);
    figure.show(this.rows ?? nothing(3), start_ms / 1000, end_ms / 1000,
      { extra: { 0: line }, decimals: 2, within: near });
    figure.setNow(state.replay?.at_utc_s ?? page.t_s);
    say(this.card.bucket, this.rows ? bucketText(this.rows.bucket_s) : "");
  };
}

/** Limits of one temperature as one line of a name each; those of equal temperature share it. */
function limitLines(limits) {
  const words = new Map();
  for (const limit of limits) {
    for (const degC of [limit.low_degC, limit.high_degC]) {
      if (!Number.isFinite(degC)) continue;
      words.set(degC, [...(words.get(degC) ?? []), t("temperature.limit", { name: limit.name, of: word("temperature", limit.of) })]);
    }
  }
  return [...words].sort(([one], [other]) => one - other).map(([y, names]) => ({ y, text: `${names.join(", ")}: ${minus(String(y))} \u00b0C` }));
}

/** What the axis holds: what is drawn, and limits not so far from it that it would be a flat line between them. */
function nearby(limits, values) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const reach = Math.max(NEAR_degC, 0.75 * (high - low));
  const kept = [low, high, ...limits.map((one) => one.y).filter((y) => y > low - reach && y < high + reach)].filter(Number.isFinite);
  const top = Math.max(...kept);
  return top > high ? [...kept, top + 0.08 * (top - Math.min(...kept))] : kept; // room for the name of the highest
}

/** The part of a polyline between two instants, its ends on them, times in ms. */
function clipped(t_s, values, first_s, last_s) {
  if (!t_s.length) return { t: [], y: [] };
  const at = (wanted_s) => {
    const next = t_s.findIndex((one) => one >= wanted_s);
    if (next < 0) return values.at(-1);
    if (next === 0 || t_s[next] === t_s[next - 1]) return values[next];
    return values[next - 1] + ((wanted_s - t_s[next - 1]) / (t_s[next] - t_s[next - 1])) * (values[next] - values[next - 1]);
  };
  const inside = t_s.map((one, index) => [one, values[index]]).filter(([one]) => one > first_s && one < last_s);
  const corners = [[first_s, at(first_s)], ...inside, [last_s, at(last_s)]];
  return { t: corners.map(([one]) => one * 1000), y: corners.map(([, value]) => value) };
}

/** Rows of air and unit as columns 1 and 2 of the figure; column 0 is the plan. */
function spread(rows, names) {
  const pairs = new Float32Array(rows.n * 6).fill(NaN);
  names.forEach((name, from) => {
    const to = 1 + TEMPERATURES.indexOf(name);
    for (let row = 0; row < rows.n; row += 1) for (const end of [0, 1]) pairs[row * 6 + to * 2 + end] = rows.pairs[(row * names.length + from) * 2 + end];
  });
  return { ...rows, signals: 3, pairs };
}

export class HistoryGraph {
  constructor(graphs, look) {
    this.views = graphs.flatMap((graph) => viewsOf(graph).map((view) => ({ ...view, title: view.name === "counts" ? `${graph.title}: ${t("graph.counts")}` : graph.title })));
    [this.view = { signals: [], curves: [], unit: "" }] = this.views;
    this.history = new History();
    this.whole = true;
    this.timer = null;
    this.asked_ms = -Infinity;
    this.card = new GraphCard(t("history.title"), this.view.curves, look, { wide: true });
    const select = make("select", { "aria-label": t("history.which"), onchange: () => this.choose(Number(select.value)) },
      ...this.views.map((view, index) => make("option", { value: index }, view.title)));
    this.all = make("button", { type: "button", onclick: () => this.showAll() }, t("history.all"));
    const closer = make("button", { type: "button", onclick: () => this.zoom(0.5), "aria-label": t("history.closer") }, "+");
    const wider = make("button", { type: "button", onclick: () => this.zoom(2), "aria-label": t("history.wider") }, "\u2212");
    this.card.choices.append(select, closer, wider, this.all);
  }

  /** The whole run is on its way while the figure is made. */
  async draw(item) {
    const span = runSpan(page.t_s);
    const rows = this.#rows(span);
    await this.card.draw(item);
    const { figure } = this.card;
    const range = figure.plot.x_range;
    range.min_interval = 1000;
    for (const end of ["start", "end"]) range.properties[end].change.connect(() => this.moved());
    figure.setUnit(this.view.unit);
    this.#range(span);
    await this.#show(rows);
  }

  choose(index) {
    this.view = this.views[index];
    const { figure } = this.card;
    this.card.setCurves(this.view.curves);
    figure.setUnit(this.view.unit);
    this.ask();
  }

  forget() { this.asked_ms = -Infinity; }

  showAll() {
    this.whole = true;
    this.#range(runSpan(page.t_s));
    this.ask();
  }

  zoom(factor) {
    const { figure } = this.card;
    const middle_s = (figure.first_s + figure.last_s) / 2;
    const half_s = Math.max(0.1, ((figure.last_s - figure.first_s) / 2) * factor);
    const { first_s, last_s } = runSpan(page.t_s);
    this.whole = false;
    this.#range({ first_s: Math.max(first_s, middle_s - half_s), last_s: Math.min(last_s, middle_s + half_s) });
    this.#later();
  }

  #range({ first_s, last_s }) {
    this.setting = true;
    this.card.figure.plot.x_range.setv({ start: first_s * 1000, end: last_s * 1000 });
    this.setting = false;
  }

  /** Somebody dragged or turned the wheel. */
  moved() {
    if (this.setting) return;
    this.whole = false;
    draw(this.card.figure.relabel);
    this.#later();
  }

  #later() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.ask(), ASK_AFTER_ms);
  }

  each_second() {
    this.card.tabulate();
    this.card.figure?.setNow(page.state.replay?.at_utc_s ?? page.t_s);
    if (this.whole && performance.now() - this.asked_ms > EVERY_ms && !this.history.busy && page.connected && this.card.figure) this.showAll();
  }

  ask() {
    const { figure } = this.card;
    if (figure) this.#show(this.#rows(figure));
  }

  async #rows({ first_s, last_s }) {
    if (!this.view.signals.length) return null;
    this.asked_ms = performance.now();
    return this.history.ask(this.view, first_s, last_s, Math.max(300, this.card.plot.clientWidth - 80));
  }

  async #show(asked) {
    const { view } = this;
    const { figure } = this.card;
    const { first_s, last_s } = figure;
    const rows = await asked;
    this.card.complain(this.history.trouble);
    if (!rows || view !== this.view) return;
    const paint = () => {
      this.setting = true;
      figure.fitted = false;
      figure.show(rows, NaN, NaN, { decimals: this.card.curves[0]?.decimals, least: view.least });
      this.setting = false;
      say(this.card.bucket, bucketText(rows.bucket_s, view.mean_s));
      say(this.card.at, `${stamp(first_s, page.state.started_utc_s)} \u2026 ${stamp(last_s, page.state.started_utc_s)}`);
      this.card.element.dataset.bucket = rows.bucket_s;
    };
    if (figure.rows.n) draw(paint);
    else paint(); // somebody waits for the first one
  }
}
