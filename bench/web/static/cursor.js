// One cursor in all figures: where the pointer or the arrow keys stand, in seconds since 1970, or null.
const listeners = new Set();
export const cursor = { t_s: null };

export function onCursor(listener) { listeners.add(listener); }

export function moveCursor(t_s) {
  if (t_s === cursor.t_s) return;
  cursor.t_s = t_s;
  for (const listener of listeners) listener();
}
