// A recording shown as if it were now: band, position, speed.
import { byId, say } from "./dom.js";
import { isReplay, page } from "./state.js";
import { t } from "./texts.js";
import { stamp } from "./time.js";

const STEPS = 1000;
let dragging = false;

export function showReplay() {
  const { replay } = page.state;
  byId("replay-band").hidden = byId("replay").hidden = !isReplay();
  if (!isReplay() || !replay) return;
  const at_s = replay.at_utc_s ?? page.t_s;
  const text = stamp(at_s, page.state.started_utc_s);
  say(byId("replay-at"), t("replay.at", { time: text }));
  say(byId("replay-play"), t(replay.playing ? "replay.pause" : "replay.play"));
  byId("replay-play").setAttribute("aria-pressed", String(Boolean(replay.playing)));
  if (document.activeElement !== byId("replay-speed")) byId("replay-speed").value = String(replay.speed);
  if (dragging) return;
  const slider = byId("replay-position");
  slider.value = Math.round(((at_s - replay.first_utc_s) / (replay.last_utc_s - replay.first_utc_s || 1)) * STEPS);
  slider.setAttribute("aria-valuetext", text);
  say(byId("replay-time"), text);
}

export function wireReplay(connection) {
  const send = (words) => connection.send({ type: "replay", ...words });
  const slider = byId("replay-position");
  const chosen_s = () => page.state.replay.first_utc_s + (slider.value / STEPS) * (page.state.replay.last_utc_s - page.state.replay.first_utc_s);
  byId("replay-play").addEventListener("click", () => send({ playing: !page.state.replay?.playing }));
  byId("replay-start").addEventListener("click", () => send({ at_utc_s: page.state.replay?.first_utc_s }));
  byId("replay-speed").addEventListener("change", () => send({ speed: Number(byId("replay-speed").value) }));
  slider.addEventListener("input", () => { dragging = true; say(byId("replay-time"), stamp(chosen_s(), page.state.started_utc_s)); });
  slider.addEventListener("change", () => { dragging = false; send({ at_utc_s: chosen_s() }); });
}
