// One Bokeh figure: its curves, axes, colours and cursor. The models come from the server; here they are filled.
import { draw, onSettings, t, theme } from "./base.js";
import { boxesOf, cursor, extent, lineOf, moveCursor, nothing, onCursor, valueTicks } from "./points.js";
import { page } from "./state.js";
import { axisName, timeTicks } from "./words.js";

const LABEL_px = 72; // room that the label of a tick of time needs
const BOX_px = 3; // a bucket wider than this is drawn as a box
const FONT = "system-ui, 'Segoe UI', 'Noto Sans', 'Malgun Gothic', 'Noto Sans KR', 'DejaVu Sans', sans-serif";

export class Figure {
  /** Args: item: json_item of the server; holder: element it is put into; look: {palettes, looks}. */
  static async embed(item, holder, look) {
    if (!window.Bokeh && document.readyState !== "complete") {
      await new Promise((done) => { for (const it of [document.getElementById("bokeh"), window]) it.addEventListener("load", done); }); // window: it failed
    }
    const views = await Bokeh.embed.embed_item(item, holder);
    return new Figure([...views].find((view) => view.model.type === "Plot"), holder, look);
  }

  constructor(view, holder, look) {
    Object.assign(this, { view, holder, look, rows: nothing(0), options: {}, focus: null });
    this.plot = view.model;
    this.model = (name) => this.plot.document.get_model_by_name(name);
    this.cursorMark = this.model("cursor");
    onCursor(() => draw(this.paintCursor));
    onSettings((what) => { if (what === "theme") this.paint(); else this.ticks(); });
    holder.addEventListener("pointermove", (event) => moveCursor(this.timeAt(event)));
    holder.addEventListener("pointerleave", () => moveCursor(null));
    new ResizeObserver(() => draw(this.relabel)).observe(holder);
    this.paint();
  }

  relabel = () => { this.ticks(); this.after?.(); };

  paintCursor = () => {
    const at = cursor.t_s === null ? null : cursor.t_s * 1000;
    if (this.cursorMark.location !== at) this.cursorMark.location = at;
    this.after?.();
  };

  get frame() { return this.view.frame.bbox; }

  get first_s() { return this.plot.x_range.start / 1000; }

  get last_s() { return this.plot.x_range.end / 1000; }

  timeAt(event) {
    const { x0, x1 } = this.frame;
    const x = event.clientX - this.holder.getBoundingClientRect().left;
    return x < x0 || x > x1 ? null : this.first_s + ((x - x0) / (x1 - x0)) * (this.last_s - this.first_s);
  }

  /** Where a value is drawn, in CSS pixels below the top of the holder. */
  yOf(value) {
    const { y0, y1 } = this.frame;
    const { start, end } = this.plot.y_range;
    return y1 - ((value - start) / (end - start)) * (y1 - y0);
  }

  /** Looks of a curve in the theme shown now. Args: index: number of the curve, or a name of the palette ("ink", "soft"). */
  style(index) {
    const palette = this.look.palettes[theme()];
    if (typeof index === "string") return { color: palette[index], dash: [] };
    const one = this.look.looks[index % this.look.looks.length];
    return { color: palette.hues[one.hue], dash: one.dash };
  }

  /** Colours of everything, after a change of theme or of what is in focus. */
  paint() {
    const palette = this.look.palettes[theme()];
    for (const name of ["time", "value"]) {
      this.model(name).setv({
        axis_line_color: palette.soft, major_tick_line_color: palette.soft, major_label_text_color: palette.soft,
        axis_label_text_color: palette.ink, major_label_text_font: FONT, axis_label_text_font: FONT,
        major_label_text_font_size: "12px", axis_label_text_font_size: "12px", axis_label_standoff: 4,
      });
      this.model(`${name}-grid`).grid_line_color = palette.grid;
    }
    this.cursorMark.line_color = palette.ink;
    this.model("now").setv({ line_color: palette.now, line_width: 1.5 });
    this.model("band")?.setv({ fill_color: palette.soft });
    this.model("limit")?.setv({ line_color: palette.now, line_width: 1.4 });
    this.model("limit-text")?.setv({ text_color: palette.now, text_font: FONT, text_font_size: "11px" });
    for (let index = 0; this.model(`line-${index}`); index += 1) {
      const { color, dash } = this.style(this.styles?.[index] ?? index);
      const away = this.focus !== null && this.focus !== index;
      this.model(`line-${index}`).setv({ line_color: color, line_dash: dash, line_alpha: away ? 0.16 : 1, line_width: this.focus === index ? 2 : 1.4 });
    }
    this.after?.();
  }

  setFocus(index) {
    this.focus = this.focus === index ? null : index;
    this.paint();
    this.show(this.rows, this.first_s, this.last_s, this.options);
  }

  /** Gives a source its columns where they are others than before. */
  fill(name, columns) {
    const key = JSON.stringify(columns);
    const source = this.model(name);
    if (source.shown === key) return;
    source.shown = key;
    source.data = columns;
  }

  /**
   * Draws rows (signals = curves) between two instants.
   * options: {lockY, decimals, extra: further {t, y} by curve number, within: values that the vertical axis holds too,
   * least: height of the vertical axis at least}.
   */
  show(rows, first_s, last_s, options = {}) {
    this.rows = rows;
    this.options = options;
    const { x0, x1 } = this.frame;
    const shown_s = last_s > first_s ? last_s - first_s : this.last_s - this.first_s;
    const line = (rows.bucket_s / shown_s) * (x1 - x0) > BOX_px ? boxesOf : lineOf;
    for (let index = 0; index < rows.signals; index += 1) {
      const source = this.model(`curve-${index}`);
      if (source) source.data = options.extra?.[index] ?? line(rows, index);
    }
    if (Number.isFinite(first_s) && last_s > first_s) this.plot.x_range.setv({ start: first_s * 1000, end: last_s * 1000 });
    if (!options.lockY) this.fitY(first_s, last_s, options.extra ?? {});
    this.ticks();
    this.after?.();
  }

  fitY(first_s, last_s, extra) {
    const within = this.options.within ?? [];
    let [low, high] = [Math.min(Infinity, ...within), Math.max(-Infinity, ...within)];
    for (let index = 0; index < this.rows.signals; index += 1) {
      if (this.focus !== null && this.focus !== index) continue;
      const found = extra[index] ? spanOf(extra[index].y) : extent(this.rows, index, first_s, last_s);
      if (found) { low = Math.min(low, found.low); high = Math.max(high, found.high); }
    }
    if (!(high >= low)) [low, high] = [0, 1];
    const lacking = ((this.options.least ?? 0) - (high - low)) / 2;
    if (lacking > 0) [low, high] = [low - lacking, high + lacking];
    const pad = high > low ? (high - low) * 0.06 : Math.max(Math.abs(high) * 1e-4, 0.5 * 10 ** -(this.options.decimals ?? 0));
    const { start, end } = this.plot.y_range;
    const room = end - start;
    // A range that follows every reading trembles: it grows at once, and shrinks only when a third of it stands empty.
    if (low >= start && high <= end && high - low > room * 0.62 && this.fitted) return;
    this.fitted = true;
    this.plot.y_range.setv({ start: low - pad, end: high + pad });
  }

  ticks() {
    const { x0, x1, y0, y1 } = this.frame;
    const started_s = page.state.started_utc_s ?? null;
    const times = timeTicks(this.first_s, this.last_s, Math.max(2, (x1 - x0) / LABEL_px), started_s);
    setTicks(this.model("time-ticks"), this.model("time"), times.map(([t_s, label]) => [t_s * 1000, label]));
    const name = axisName(this.first_s, { utc: t("axis.utc"), local: t("axis.local"), elapsed: t("axis.elapsed") });
    if (this.model("time").axis_label !== name) this.model("time").axis_label = name;
    const { start, end } = this.plot.y_range;
    const { ticks, decimals } = valueTicks(start, end, Math.max(2, (y1 - y0) / 34));
    setTicks(this.model("value-ticks"), this.model("value"), ticks.map((value) => [value, minus(value.toFixed(decimals))]));
  }

  setNow(t_s) {
    const at = t_s === null || !Number.isFinite(t_s) ? null : t_s * 1000;
    if (this.model("now").location !== at) this.model("now").location = at;
  }

  setUnit(unit) {
    if (this.model("value").axis_label !== unit) this.model("value").axis_label = unit;
  }
}

/** A true minus sign, and no minus before zero. */
export const minus = (text) => (/^-0(\.0*)?$/.test(text) ? text.slice(1) : text.replaceAll("-", "\u2212"));

function spanOf(values) {
  const finite = [...values].filter(Number.isFinite);
  return finite.length ? { low: Math.min(...finite), high: Math.max(...finite) } : null;
}

function setTicks(ticker, axis, labelled) {
  const key = JSON.stringify(labelled);
  if (ticker.shown === key) return;
  ticker.shown = key;
  axis.major_label_overrides = new Map(labelled);
  ticker.ticks = labelled.map(([at]) => at);
}
