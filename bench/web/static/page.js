// The page of one run: puts its parts together.
import { showAlarms } from "./alarms.js";
import { followLease, showCommands, wireCommands } from "./commands.js";
import { Connection } from "./connection.js";
import { byId, say } from "./dom.js";
import { draw } from "./draw.js";
import { showEstimates } from "./estimates.js";
import { showAge, showHead } from "./head.js";
import { LiveGraph } from "./live-graph.js";
import { showLog, showPanels } from "./panels.js";
import { showPrompt, wirePrompt } from "./prompt.js";
import { showOutcome } from "./outcome.js";
import { showReplay, wireReplay } from "./replay.js";
import { Ring } from "./ring.js";
import { onSettings } from "./settings.js";
import { greet, wireKeys, wireSettings } from "./shell.js";
import { freshness, isReplay, on, page } from "./state.js";
import { loadTexts, t } from "./texts.js";
import { HistoryGraph, TemperatureGraph } from "./wide-graphs.js";

const AGE_EVERY_ms = 250;
const SLOW_EVERY_ms = 1000;
const BEGIN_AGAIN_ms = 2000;

let graphs = [];
let drawn = null; // what the figures were made for
let seen = null; // boot and place of what is shown

function trouble(text) {
  byId("trouble").hidden = !text;
  say(byId("trouble"), text ?? "");
}

const askFigures = () => fetch(`/api/v1/runs/${encodeURIComponent(page.run)}/figures`);
let early = askFigures(); // on its way while the rest of the page begins
early.catch(() => {}); // told when it is needed

/** Figures for what the run measures; made once, and again only where another run takes this name. */
async function drawFigures() {
  const wanted = JSON.stringify([page.state.graphs, page.state.signals]);
  if (drawn === wanted || !page.state.graphs) return;
  drawn = wanted;
  try {
    const reply = await (early ?? askFigures());
    early = null;
    if (!reply.ok) throw new Error(`HTTP ${reply.status}`);
    await placeFigures(await reply.json());
  } catch (error) {
    drawn = early = null;
    trouble(t("trouble.figures", { why: error.message })); // never a silent "no plot"
    setTimeout(drawFigures, BEGIN_AGAIN_ms);
  }
}

async function placeFigures(made) {
  const look = { palettes: made.palettes, looks: made.looks };
  const live = page.state.graphs.map((graph, number) => new LiveGraph(graph, number, look));
  const history = new HistoryGraph(page.state.graphs, look);
  const temperature = new TemperatureGraph(look, live.length % 2 === 0); // beside an odd graph there is room
  graphs = [...live, temperature, history];
  page.history = history;
  byId("graphs").replaceChildren(...graphs.map((graph) => graph.card.element));
  await Promise.all(live.map((graph, number) => graph.draw(made.graphs[number])));
  for (const graph of live) graph.points(ring);
  draw(() => { if (ring.count) document.documentElement.dataset.firstPoints ??= Math.round(performance.now()); }); // ms since the page was asked for
  trouble(null);
  await temperature.draw(made.temperature);
  await history.draw(made.history);
}

function everything() {
  showHead();
  showOutcome();
  showPanels(true);
  showEstimates(true);
  showAlarms();
  showReplay();
  showCommands();
}

const ring = new Ring();

function changed() {
  showHead();
  showOutcome();
  showPanels();
  showEstimates();
  showAlarms();
  showReplay();
  showCommands();
  showPrompt();
  followLease();
}

on("snapshot", () => {
  page.t_s = page.state.replay?.at_utc_s ?? page.state.t_utc_s;
  const place = `${page.state.boot_id} ${page.state.source}`;
  if (seen !== place || isReplay()) for (const graph of graphs) graph.forget?.();
  seen = place;
  drawFigures();
});
on("state", changed);
on("points", () => {
  page.t_s = Math.max(ring.last_s, isReplay() ? -Infinity : page.t_s || -Infinity);
  for (const graph of graphs) graph.points?.(ring);
});
on("connection", ({ trouble: key }) => {
  if (key) trouble(t(key));
  showHead();
  showCommands();
});
onSettings((what) => { if (what === "time") everything(); });

let fresh = null;
function watchAge() {
  showAge();
  if (fresh === freshness()) return;
  fresh = freshness();
  showHead();
  showCommands();
}

async function begin() {
  wireSettings();
  await loadTexts();
  greet().then((found) => { page.person = found; showCommands(); });
  wireCommands();
  wirePrompt();
  byId("log-filter").addEventListener("input", showLog);
  byId("log-severity").addEventListener("change", showLog);
  const connection = new Connection(page.run, ring);
  wireReplay(connection);
  wireKeys({
    0: () => page.history?.showAll(), "+": () => page.history?.zoom(0.5), "-": () => page.history?.zoom(2) });
  setInterval(watchAge, AGE_EVERY_ms);
  setInterval(() => {
    if (document.hidden) return;
    for (const graph of graphs) graph.each_second();
    if (page.everConnected) changed();
  }, SLOW_EVERY_ms);
  document.addEventListener("visibilitychange", watchAge);
}

begin();
