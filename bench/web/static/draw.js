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
