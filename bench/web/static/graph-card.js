// The card around a figure: title, choice of window, curves by name at the right end, numbers as a table.
import { fillTable, make, say, t } from "./base.js";
import { Figure, minus } from "./figure.js";
import { bucketAt, cursor, extent, moveCursor, nothing, sharedPrefix } from "./points.js";

const HEIGHT_px = 24;

export class GraphCard {
  /** Args: title; curves: [{name, unit, decimals}]; options: {wide, look}. */
  constructor(title, curves, look, { wide = false } = {}) {
    Object.assign(this, { title, curves, look, figure: null });
    const id = `graph-${GraphCard.made = (GraphCard.made ?? 0) + 1}`;
    this.heading = make("h2", { id }, title);
    this.choices = make("div", { class: "choices", role: "group", "aria-label": t("graph.window") });
    this.plot = make("div", { class: "plot", tabindex: "0", role: "img", "aria-labelledby": id, "aria-describedby": `${id}-bucket` });
    this.ends = make("div", { class: "ends", role: "group", "aria-label": t("graph.curves") });
    this.bucket = make("span", { id: `${id}-bucket` });
    this.at = make("span");
    this.why = make("span", { class: "trouble" });
    this.table = make("table");
    this.numbers = make("details", { class: "numbers", ontoggle: () => this.tabulate() }, make("summary", {}, t("graph.as-table")),
      make("div", { class: "scroll" }, this.table));
    this.element = make("figure", { class: wide ? "card graph wide" : "card graph", "aria-labelledby": id }, make("header", {}, this.heading, this.choices),
      make("div", { class: "plot-row" }, this.plot, this.ends), make("p", { class: "bucket" }, this.bucket, this.at, this.why), this.numbers);
    this.plot.addEventListener("keydown", (event) => this.key(event));
    this.setCurves(curves);
  }

  async draw(item) {
    this.figure = await Figure.embed(item, this.plot, this.look);
    this.figure.styles = this.curves.map((curve, index) => curve.style ?? index);
    this.figure.after = () => this.label();
    this.figure.paint();
  }

  setCurves(curves) {
    this.curves = curves;
    const prefix = sharedPrefix(curves.map((curve) => curve.label ?? curve.name));
    this.marks = curves.map((curve, index) => {
      const short = (curve.label ?? curve.name).slice(prefix.length).replace(/\]$/, prefix.endsWith("[") ? "" : "]");
      const line = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      line.setAttribute("viewBox", "0 0 26 10");
      line.innerHTML = '<line x1="0" y1="5" x2="26" y2="5" stroke-width="2.5"></line>';
      const value = make("span", { class: "value" });
      const button = make("button", { type: "button", title: curve.name, "aria-pressed": "false", onclick: () => this.focus(index) },
        line, make("span", {}, short), value);
      return { button, value, line: line.firstChild };
    });
    this.ends.replaceChildren(...this.marks.map((mark) => mark.button));
    const { figure } = this;
    if (!figure) return;
    figure.focus = null;
    figure.styles = curves.map((curve, index) => curve.style ?? index);
    figure.show(nothing(figure.look.looks.length), figure.first_s, figure.last_s); // what is drawn is of other curves
    figure.fitted = false;
    figure.paint();
  }

  focus(index) {
    this.figure.setFocus(index);
    this.ends.classList.toggle("focused", this.figure.focus !== null);
    this.marks.forEach((mark, at) => mark.button.setAttribute("aria-pressed", String(this.figure.focus === at)));
  }

  /** Names at the right end of their curves, pushed apart where they would cover each other; values there or at the cursor. */
  label() {
    const { figure } = this;
    if (!figure) return;
    const inside = cursor.t_s !== null && cursor.t_s >= figure.first_s && cursor.t_s <= figure.last_s;
    const at_s = inside ? cursor.t_s : figure.last_s;
    const wanted = this.marks.map((mark, index) => {
      const { color, dash } = figure.style(figure.styles[index]);
      mark.line.setAttribute("stroke", color);
      mark.line.setAttribute("stroke-dasharray", dash.join(" "));
      const extra = figure.options.extra?.[index];
      const bucket = extra ? planned(extra, at_s) : bucketAt(figure.rows, index, at_s);
      say(mark.value, bucket ? this.text(bucket, index) : "\u2013");
      const end = extra ? planned(extra, figure.last_s) : bucketAt(figure.rows, index, figure.last_s);
      return { mark, y: end ? figure.yOf((end[0] + end[1]) / 2) - HEIGHT_px / 2 : Infinity };
    });
    this.place(wanted);
  }

  place(wanted) {
    const { y0, y1 } = this.figure.frame;
    const room = Math.min(HEIGHT_px, (y1 - y0 + 30) / Math.max(1, wanted.length));
    const top = Math.max(0, y0 - 6);
    const bottom = y1 + 24 - room;
    wanted.sort((one, other) => one.y - other.y);
    let least = top;
    for (const one of wanted) { one.y = Math.max(Math.min(one.y, bottom), least); least = one.y + room; }
    let most = bottom;
    for (const one of [...wanted].reverse()) { one.y = Math.min(one.y, most); most = one.y - room; }
    for (const { mark, y } of wanted) { const text = `${Math.round(y)}px`; if (mark.button.style.top !== text) mark.button.style.top = text; }
  }

  text(bucket, index) {
    const decimals = this.curves[index].decimals ?? 3;
    const [low, high] = bucket.map((value) => minus(value.toFixed(decimals)));
    return low === high ? low : `${low}\u2026${high}`;
  }

  /** Why there is no history to draw: never a silent empty graph. */
  complain(trouble) { say(this.why, trouble ? t("history.none", { why: trouble }) : ""); }

  tabulate() {
    const { figure } = this;
    if (!this.numbers.open || !figure) return;
    const columns = ["curve", "last", "min", "max", "mean"].map((name, index) => ({ head: t(`graph.${name}`), class: index ? "number" : "fixed" }));
    const rows = this.curves.map((curve, index) => {
      const found = figure.options.extra?.[index] ? null : extent(figure.rows, index, figure.first_s, figure.last_s);
      const number = (value, more = 0) => minus(value.toFixed((curve.decimals ?? 3) + more));
      const named = curve.label ? `${curve.label} (${curve.name})` : curve.name;
      return { key: curve.name, cells: [`${named} / ${curve.unit}`, ...(found
        ? [this.text(found.last, index), number(found.low), number(found.high), number(found.mean, 2)] : ["\u2013", "\u2013", "\u2013", "\u2013"])] };
    });
    fillTable(this.table, columns, rows, t("graph.nothing"));
  }

  key(event) {
    const { figure } = this;
    if (!figure || !["ArrowLeft", "ArrowRight", "Escape"].includes(event.key)) return;
    event.preventDefault();
    if (event.key === "Escape") { moveCursor(null); return; }
    const step_s = (figure.last_s - figure.first_s) / (event.shiftKey ? 20 : 200);
    const from_s = cursor.t_s ?? figure.last_s;
    moveCursor(Math.min(figure.last_s, Math.max(figure.first_s, from_s + (event.key === "ArrowLeft" ? -step_s : step_s))));
  }
}

/** Value of a polyline at an instant as a bucket of no width; its ends hold on. Null where there is no line. */
function planned(line, at_s) {
  const last = line.t.length - 1;
  if (last < 0) return null;
  const at_ms = Math.min(Math.max(at_s * 1000, line.t[0]), line.t[last]);
  const next = Math.max(1, line.t.findIndex((t_ms) => t_ms >= at_ms));
  if (last === 0) return [line.y[0], line.y[0]];
  const part = line.t[next] > line.t[next - 1] ? (at_ms - line.t[next - 1]) / (line.t[next] - line.t[next - 1]) : 1;
  const value = line.y[next - 1] + part * (line.y[next] - line.y[next - 1]);
  return [value, value];
}

/** Buttons of which one is pressed. choices: [[value, text]]. Returns a function that presses one. */
export function choiceOf(holder, choices, chosen, onChoice) {
  const buttons = choices.map(([value, text]) => make("button", { type: "button", "aria-pressed": String(value === chosen), onclick: () => press(value, true) }, text));
  const press = (value, told) => {
    choices.forEach(([one], index) => buttons[index].setAttribute("aria-pressed", String(one === value)));
    if (told) onChoice(value);
  };
  holder.append(...buttons);
  return press;
}
