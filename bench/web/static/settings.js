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
