// What every page is made with: texts, elements, drawing, units, settings.

// The catalogue: every text of the page by key. English stands in for what a language does not have yet.
let catalogue = {};

export async function loadTexts() {
  const reply = await fetch("/api/v1/texts");
  if (reply.ok) catalogue = await reply.json();
}

/** The text of a key with its {names} filled in; a key without text shows itself, so that it is seen. */
export function t(key, values = {}) {
  return (catalogue[key] ?? key).replace(/\{(\w+)\}/g, (whole, name) => (name in values ? values[name] : whole));
}

/** The text of a key of a family (`state.` + name), or the name itself where a newer run knows more words than this page. */
export function word(family, name) {
  return catalogue[`${family}.${name}`] ?? String(name ?? "");
}

/** A code and what it means; the text of an error begins with its code already. */
export function withCode(code, text, between) {
  return text?.startsWith(`error ${code}:`) ? text : [code, text].filter(Boolean).join(between);
}

// The few things the page does with its document. Texts go in as text, never as markup.
export const byId = (id) => document.getElementById(id);

export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "class") element.className = value;
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** Sets the text only where it differs: no layout, no lost selection. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function icon(name) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("aria-hidden", "true");
  const use = document.createElementNS("http://www.w3.org/2000/svg", "use");
  use.setAttribute("href", `/static/icons.svg#${name}`);
  svg.append(use);
  return svg;
}

export function setIcon(svg, name) {
  const use = svg.querySelector("use");
  const href = `/static/icons.svg#${name}`;
  if (use.getAttribute("href") !== href) use.setAttribute("href", href);
}

/**
 * Brings a table to the rows given; rows stay the same elements while their key stays, so focus and selection survive.
 * columns: [{head, class}]; rows: [{key, class, cells: [text or Node]}].
 */
export function fillTable(table, columns, rows, empty) {
  if (!table.tHead || table.tHead.rows[0].cells.length !== columns.length) {
    table.setAttribute("role", "table"); // roles by name: on a phone rows are shown one under the other, and a browser may forget that this is a table
    table.replaceChildren(make("thead", { role: "rowgroup" }, make("tr", { role: "row" },
      ...columns.map((column) => make("th", { scope: "col", role: "columnheader", class: column.class ?? "" })))), make("tbody", { role: "rowgroup" }));
  }
  columns.forEach((column, index) => say(table.tHead.rows[0].cells[index], column.head));
  const body = table.tBodies[0];
  if (!rows.length) {
    body.replaceChildren(make("tr", { role: "row" }, make("td", { role: "cell", colspan: columns.length, class: "empty" }, empty)));
    return;
  }
  const known = new Map([...body.rows].map((row) => [row.dataset.key, row]));
  const wanted = rows.map((row) => {
    const element = known.get(String(row.key)) ?? make("tr", { role: "row", "data-key": row.key },
      ...columns.map((column) => make("td", { role: "cell", class: column.class ?? "", "data-head": column.head })));
    if (element.className !== (row.class ?? "")) element.className = row.class ?? "";
    row.cells.forEach((cell, index) => {
      if (cell instanceof Node) { if (element.cells[index].firstChild !== cell) element.cells[index].replaceChildren(cell); }
      else say(element.cells[index], String(cell ?? ""));
    });
    return element;
  });
  const same = body.rows.length === wanted.length && wanted.every((row, index) => body.rows[index] === row);
  if (!same) body.replaceChildren(...wanted);
}

// Drawing waits for the screen: at most ten times a second, and never while nobody can see it.
const SPACING_ms = 90;
const waiting = new Set();
let last_ms = -Infinity;
let asked = false;

function frame(now_ms) {
  asked = false;
  if (document.hidden) return; // whatever waits is drawn when the tab is seen again
  if (now_ms - last_ms < SPACING_ms) { ask(); return; }
  last_ms = now_ms;
  const jobs = [...waiting];
  waiting.clear();
  for (const job of jobs) job();
}

function ask() {
  if (!asked && !document.hidden) { asked = true; requestAnimationFrame(frame); }
}

/** Does a job once at the next drawing, however often it was asked for until then. */
export function draw(job) {
  waiting.add(job);
  ask();
}

document.addEventListener("visibilitychange", () => { asked = false; if (waiting.size) ask(); });

// Units as people write them; the protocol has them in letters every keyboard knows.
const WRITTEN = { degC: "\u00b0C", "degC/min": "\u00b0C/min", uA: "\u00b5A", us: "\u00b5s", "ppm/degC": "ppm/\u00b0C", deg: "\u00b0" };

/** A text of the run with its units as people write them. */
export const inUnits = (text) => (text ?? "").replaceAll("degC", "\u00b0C");

export const unitText = (unit) => WRITTEN[unit] ?? (unit ?? "").replace("degC", "\u00b0C");

// What this browser remembers: theme, form of time, shortcuts, windows. Nothing of it is secret.
const PREFIX = "bench.";

export function remembered(name, fallback) {
  try { return localStorage.getItem(PREFIX + name) ?? fallback; } catch { return fallback; }
}

export function remember(name, value) {
  try { localStorage.setItem(PREFIX + name, String(value)); } catch { /* private window: valid until it is closed */ }
}

const listeners = new Set();

/** Calls `listener(what)` when theme or form of time has changed. */
export function onSettings(listener) { listeners.add(listener); }

export function theme() { return document.documentElement.dataset.theme === "light" ? "light" : "dark"; }

export function turnTheme() {
  document.documentElement.dataset.theme = theme() === "light" ? "dark" : "light";
  remember("theme", theme());
  for (const listener of listeners) listener("theme");
}

export function timeForm() { return remembered("time", "utc"); }

export function setTimeForm(form) {
  remember("time", form);
  for (const listener of listeners) listener("time");
}

export function shortcutsOn() { return remembered("shortcuts", "on") === "on"; }
