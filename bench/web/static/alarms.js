// Alarms: they stay until acknowledged and over; each is announced once.
import { byId, icon, make, say } from "./dom.js";
import { command, onMayCommand } from "./commands.js";
import { mayCommand, page } from "./state.js";
import { t, withCode, word } from "./texts.js";
import { stamp } from "./time.js";

const items = new Map();
const announced = new Set();

function item(alarm) {
  const known = items.get(alarm.id);
  if (known) return known;
  const parts = { time: make("span"), text: make("span", { class: "text" }), state: make("span", { class: "soft" }) };
  const button = make("button", { type: "button", onclick: () => command({ command: "acknowledge", alarm: alarm.id }) }, t("alarm.acknowledge"));
  const element = make("li", { class: alarm.severity },
    make("span", { class: "word" }, icon(alarm.severity), word("alarm", alarm.severity)), parts.time, parts.text, parts.state, button);
  const made = { element, button, ...parts };
  items.set(alarm.id, made);
  return made;
}

function stateOf(alarm) {
  const now = alarm.active ? t("alarm.active") : t("alarm.over");
  const by = alarm.acknowledged ? t("alarm.by", { by: alarm.acknowledged.by, time: stamp(alarm.acknowledged.t_utc_s, page.state.started_utc_s) }) : "";
  const { shelved } = alarm;
  const shelf = shelved ? t("alarm.shelved", { time: stamp(shelved.until_utc_s, page.state.started_utc_s), by: shelved.by, reason: shelved.reason }) : "";
  return [now, by, shelf].filter(Boolean).join(" \u00b7 ");
}

export function showAlarms() {
  const alarms = page.state.alarms ?? [];
  byId("alarms-card").hidden = !alarms.length;
  const elements = alarms.map((alarm) => {
    const one = item(alarm);
    one.element.classList.toggle("quiet", Boolean(alarm.acknowledged || alarm.shelved));
    say(one.time, stamp(alarm.t_utc_s, page.state.started_utc_s));
    say(one.text, withCode(alarm.code, alarm.text, " "));
    say(one.state, stateOf(alarm));
    one.button.hidden = Boolean(alarm.acknowledged) || page.state.source === "replay";
    one.button.disabled = !mayCommand();
    return one.element;
  });
  const list = byId("alarms");
  if (list.children.length !== elements.length || elements.some((element, index) => list.children[index] !== element)) list.replaceChildren(...elements);
  for (const id of [...items.keys()]) if (!alarms.some((alarm) => alarm.id === id)) items.delete(id);
  announce(alarms);
}

function announce(alarms) {
  const fresh = alarms.filter((alarm) => alarm.active && !alarm.acknowledged && !alarm.shelved && !announced.has(alarm.id));
  for (const id of [...announced]) if (!alarms.some((alarm) => alarm.id === id)) announced.delete(id);
  if (!fresh.length) return;
  for (const alarm of fresh) announced.add(alarm.id);
  byId("announce").replaceChildren(...fresh.map((alarm) => make("p", {}, `${word("alarm", alarm.severity)}: ${alarm.text}`)));
}

onMayCommand(showAlarms);
