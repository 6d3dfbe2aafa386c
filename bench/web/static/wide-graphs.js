// The two figures of the whole run: temperature planned and actual, and the history that can be zoomed to single readings.
import { nothing } from "./curves.js";
import { make, say } from "./dom.js";
import { draw } from "./draw.js";
import { GraphCard } from "./graph-card.js";
import { History, runSpan } from "./history.js";
import { bucketText, curvesOf } from "./live-graph.js";
import { page } from "./state.js";
import { t } from "./texts.js";
import { stamp } from "./time.js";
import { unitText } from "./units.js";

const TEMPERATURES = ["bench.air", "bench.unit"];
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
    const { first_s, last_s } = runSpan(page.t_s);
    const rows = await this.history.ask(names, first_s, last_s, 1000);
    this.card.complain(this.history.trouble);
    if (rows) { this.rows = spread(rows, names); draw(this.paint); }
  }

  paint = () => {
    const { figure } = this.card;
    const { state } = page;
    if (!figure || !state.started_utc_s) return;
    const plan = state.timetable ?? { t_utc_s: [], temperature_degC: [] };
    const { first_s, last_s } = runSpan(page.t_s);
    const end_s = Math.max(last_s, plan.t_utc_s.at(-1) ?? -Infinity);
    const line = { t: plan.t_utc_s.map((t_s) => t_s * 1000), y: plan.temperature_degC };
    const rows = this.rows ?? nothing(3);
    const room = (end_s - first_s) * 0.01;
    figure.show(rows, first_s - room, end_s + room, { extra: { 0: line }, decimals: 2 });
    figure.setNow(state.replay?.at_utc_s ?? page.t_s);
    say(this.card.bucket, this.rows ? bucketText(this.rows.bucket_s) : "");
  };
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
    this.graphs = graphs;
    this.chosen = 0;
    this.history = new History();
    this.whole = true;
    this.timer = null;
    this.asked_ms = -Infinity;
    this.card = new GraphCard(t("history.title"), graphs.length ? curvesOf(graphs[0]) : [], look, { wide: true });
    const select = make("select", { "aria-label": t("history.which"), onchange: () => this.choose(Number(select.value)) },
      ...graphs.map((graph, index) => make("option", { value: index }, graph.title)));
    this.all = make("button", { type: "button", onclick: () => this.showAll() }, t("history.all"));
    const closer = make("button", { type: "button", onclick: () => this.zoom(0.5), "aria-label": t("history.closer") }, "+");
    const wider = make("button", { type: "button", onclick: () => this.zoom(2), "aria-label": t("history.wider") }, "\u2212");
    this.card.choices.append(select, closer, wider, this.all);
  }

  async draw(item) {
    await this.card.draw(item);
    const { figure } = this.card;
    const range = figure.plot.x_range;
    range.min_interval = 1000;
    for (const end of ["start", "end"]) range.properties[end].change.connect(() => this.moved());
    figure.setUnit(unitText(this.graphs[this.chosen]?.unit));
    this.showAll();
  }

  choose(index) {
    this.chosen = index;
    const { figure } = this.card;
    figure.show(nothing(figure.look.looks.length), figure.first_s, figure.last_s);
    this.card.setCurves(curvesOf(this.graphs[index]));
    figure.setUnit(unitText(this.graphs[index].unit));
    figure.fitted = false;
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

  async ask() {
    const graph = this.graphs[this.chosen];
    const { figure } = this.card;
    if (!graph || !figure) return;
    this.asked_ms = performance.now();
    const { first_s, last_s } = figure;
    const rows = await this.history.ask(graph.signals, first_s, last_s, Math.max(300, this.card.plot.clientWidth - 80));
    this.card.complain(this.history.trouble);
    if (!rows || graph !== this.graphs[this.chosen]) return;
    draw(() => {
      this.setting = true;
      figure.fitted = false;
      figure.show(rows, NaN, NaN, { decimals: this.card.curves[0]?.decimals });
      this.setting = false;
      say(this.card.bucket, bucketText(rows.bucket_s));
      say(this.card.at, `${stamp(first_s, page.state.started_utc_s)} \u2026 ${stamp(last_s, page.state.started_utc_s)}`);
      this.card.element.dataset.bucket = rows.bucket_s;
    });
  }
}
