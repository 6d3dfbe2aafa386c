// The fleet page: every bench in one line, those that need somebody first. Links only: a bench is commanded on its own page.
import { byId, fillTable, icon, inUnits, loadTexts, make, onSettings, say, t, withCode, word } from "./base.js";
import { Connection } from "./connection.js";
import { showCalibrated } from "./fleet-history.js";
import { greet, wireKeys, wireSettings } from "./shell.js";
import { freshness, on, page } from "./state.js";
import { stamp, unconfirmedText } from "./words.js";

const ATTENTION = ["much", "some", "none"];
const STATES = ["unknown", "lost", "stopped", "holding", "waiting", "connecting", "starting", "running", "ending", "idle"];
const COLUMNS = ["bench", "state", "run", "now", "progress", "outputs"];
const LOOK_ms = 250;
let chosen = ""; // "", "need", or the state that the table is filtered by
let trouble = null;
let known = null; // whether the rows were drawn while the server was heard
let drawn = new Map(); // name -> {card, cells}: what has not changed is not drawn again

const heard = () => freshness() === "fresh";
const unitOf = (card) => [card.uut?.model, card.uut?.serial].filter(Boolean).join(" ");
const rank = (list, name) => (list.indexOf(name) + list.length + 1) % (list.length + 1); // what is not in it stands last

/** What may be claimed now: nothing at all while this page does not hear its server. */
function claimed(card) {
  if (heard()) return card;
  const { name, place, url, run, title, uut } = card;
  return { name, place, url, run, title, uut, state: "unknown", attention: "much", why: "server" };
}

function linked(text, card, path) {
  return card.url ? make("a", { href: `${card.url}${path}` }, text) : make("span", {}, text);
}

function benchCell(card) {
  return make("span", {}, make("strong", {}, linked(card.name, card, "/")), card.place ? make("span", { class: "soft fleet-line" }, ` ${card.place}`) : null);
}

function stateCell(card) {
  const since = card.state === "unknown" && card.heard_utc_s ? t("fleet.heard", { time: stamp(card.heard_utc_s) }) : "";
  return make("span", { class: "fleet-state", "data-state": card.state, "data-attention": card.attention }, make("strong", {}, icon(card.state), word("state", card.state)),
    card.simulated ? make("span", { class: "tag" }, t("page.simulated")) : null,
    card.why ? make("span", { class: "soft fleet-line" }, [word("fleet.why", card.why), since].filter(Boolean).join("; ")) : null);
}

function runCell(card) {
  if (!card.run) return "";
  const place = `/runs/${encodeURIComponent(card.run)}`;
  const lead = card.state === "idle" ? t("fleet.last") : card.state === "unknown" ? t("fleet.was") : "";
  return make("span", {}, lead ? make("span", { class: "soft" }, `${lead} `) : null, linked(card.title || card.run, card, place), make("span", { class: "soft fleet-line" }, ` ${unitOf(card)}`),
    card.more ? make("span", {}, ` ${t("fleet.more-runs", { count: card.more })}`) : null);
}

function nowCell(card) {
  const wait = card.asks ? t("start.asks", { text: card.asks }) : card.waits ? t("start.waits", { reason: inUnits(card.waits) }) : inUnits(card.what);
  const count = card.alarm_count ? t(card.alarm_count === 1 ? "start.alarm" : "start.alarms", { count: card.alarm_count }) : "";
  const outcome = outcomeOf(card);
  if (!count && !card.guard && !card.unconfirmed && !wait && !outcome) return "";
  return make("span", { class: "fleet-now" }, count ? make("strong", { class: "alarm-count" }, icon("alarm"), count) : null,
    ...(card.alarms ?? []).map((alarm) => make("span", { class: "alarm-line" }, `${word("alarm", alarm.severity)} ${withCode(alarm.code, alarm.text, " ")}`)),
    card.unconfirmed ? make("strong", { class: "not-off" }, unconfirmedText(card.unconfirmed)) : null,
    card.guard ? make("span", {}, t("start.guard", { reason: card.guard })) : null, wait ? make("span", {}, wait) : null, outcome);
}

/** How the newest session of a bench has ended on which nothing runs. */
function outcomeOf({ outcome, off }) {
  if (!outcome) return null;
  return make("span", { class: "outcome", "data-outcome": outcome }, make("strong", {}, icon(`outcome-${outcome}`), word("outcome", outcome)),
    off === false ? make("strong", { class: "not-off" }, ` ${t("start.not-off")}`) : null);
}

function progressCell(card) {
  const share = Number.isFinite(card.progress) ? `${(100 * card.progress).toFixed(1)} %` : "";
  return [share, card.end_utc_s ? t("start.end", { time: stamp(card.end_utc_s).replace(/:00(?=Z|[+-])/, "") }) : ""].filter(Boolean).join(" \u00b7 ");
}

function outputsCell(card) {
  const state = card.state === "unknown" ? "unknown" : card.outputs;
  if (!state) return card.state === "idle" ? make("span", { class: "soft" }, t("fleet.unwatched")) : "";
  return make("span", { class: "bench-word fleet-outputs", "data-outputs": state }, icon(`bench-${state}`), make("strong", {}, word("bench", state)));
}

const CELLS = [benchCell, stateCell, runCell, nowCell, progressCell, outputsCell];

/** The cell that is there already, if it says the same: whoever stands on its link stays there. */
const kept = (before, cell) => (before instanceof Node && cell instanceof Node && before.isEqualNode(cell) ? before : cell);

function row(card) {
  const before = drawn.get(card.name);
  if (before?.card === card) return before;
  const cells = CELLS.map((cell, index) => kept(before?.cells[index], cell(card)));
  const text = [card.name, card.place, card.run, card.title, unitOf(card), word("state", card.state), card.waits, card.asks].join(" ").toLowerCase();
  const made = { card, cells, text };
  drawn.set(card.name, made);
  return made;
}

function filters(cards) {
  const counts = new Map([["", cards.length], ["need", cards.filter((card) => card.attention !== "none").length]]);
  for (const card of cards) counts.set(card.state, (counts.get(card.state) ?? 0) + 1);
  const names = ["", "need", ...STATES.filter((name) => counts.has(name))];
  if (!names.includes(chosen)) chosen = "";
  const labels = names.map((name) => `${name === "" ? t("start.all") : name === "need" ? t("fleet.need-filter") : word("state", name)} ${counts.get(name)}`);
  const mark = `${chosen} ${labels.join()}`;
  if (byId("states").dataset.mark === mark) return counts;
  const focused = document.activeElement?.dataset?.filter;
  byId("states").dataset.mark = mark;
  byId("states").replaceChildren(...names.map((name, index) => make("button", { type: "button", "aria-pressed": String(chosen === name), "data-filter": name || "all",
    onclick: () => { chosen = name; show(); } }, labels[index])));
  if (focused) byId("states").querySelector(`[data-filter="${focused}"]`)?.focus(); // the buttons are new, who stands on one stays there
  return counts;
}

function show() {
  known = heard();
  const cards = Object.values(page.state.benches ?? {}).map(claimed);
  for (const name of drawn.keys()) if (!(name in (page.state.benches ?? {}))) drawn.delete(name);
  const counts = filters(cards);
  const wanted = byId("search").value.trim().toLowerCase().split(/\s+/).filter(Boolean);
  const found = cards.map(row).filter(({ card, text }) => (!chosen || (chosen === "need" ? card.attention !== "none" : card.state === chosen)) && wanted.every((one) => text.includes(one)));
  found.sort(({ card: one }, { card: other }) => rank(ATTENTION, one.attention) - rank(ATTENTION, other.attention)
    || rank(STATES, one.state) - rank(STATES, other.state) || one.name.localeCompare(other.name, "en", { numeric: true }));
  const focused = document.activeElement;
  const columns = COLUMNS.map((name) => ({ head: t(`fleet.${name}`), class: "" }));
  fillTable(byId("benches"), columns, found.map(({ card, cells }) => ({ key: card.name, class: `need-${card.attention} is-${card.state}`, cells })), t("fleet.no-match"));
  if (focused !== document.activeElement && focused?.isConnected) focused.focus({ preventScroll: true }); // its row has moved
  say(byId("found"), t("fleet.found", { shown: found.length, found: cards.length }));
  const need = counts.get("need");
  say(byId("need"), cards.length ? t(need === 0 ? "fleet.need-none" : need === 1 ? "fleet.need-one" : "fleet.need", { count: need }) : "");
  byId("need").dataset.attention = ATTENTION.find((name) => cards.some((card) => card.attention === name)) ?? "none";
  document.title = need ? `(${need}) ${t("fleet.title")}` : t("fleet.title");
  const wrong = trouble ?? (page.everConnected && !known ? "trouble.server" : null);
  byId("trouble").hidden = !wrong;
  say(byId("trouble"), wrong ? t(wrong) : "");
}

async function begin() {
  wireSettings();
  wireKeys();
  await loadTexts();
  await greet();
  const again = () => { drawn = new Map(); show(); };
  byId("search").addEventListener("input", show);
  onSettings((what) => { if (what === "time") again(); });
  on("state", show);
  on("connection", (heardOf) => { trouble = heardOf.trouble; show(); });
  new Connection("/ws", null);
  setInterval(() => { if (known !== heard()) show(); }, LOOK_ms);
  addEventListener("pageshow", again); // a page from the cache of the browser says what it heard long ago
  showCalibrated();
}

begin();
