// The page of one run: puts its parts together.
import { byId, draw, loadTexts, onSettings, say, t } from "./base.js";
import { followLease, showCommands, showPrompt, wireCommands, wirePrompt } from "./commands.js";
import { Connection } from "./connection.js";
import { showEstimates } from "./estimates.js";
import { showAge, showAlarms, showHead, showOutcome, showReplay, wireReplay } from "./head.js";
import { isOfBench, LiveGraph } from "./live-graph.js";
import { showLog, showPanels } from "./panels.js";
import { Ring } from "./points.js";
import { greet, wireKeys, wireSettings } from "./shell.js";
import { freshness, isReplay, on, page } from "./state.js";
import { HistoryGraph, TemperatureGraph } from "./wide-graphs.js";

const AGE_EVERY_ms = 250;
const SLOW_EVERY_ms = 1000;
const BEGIN_AGAIN_ms = 2000;
const SOON_ms = 800;

let graphs = [];
let drawn = null; // what the figures were made for
let seen = null; // boot and place of what is shown

function trouble(text) {
  byId("trouble").hidden = !text;
  say(byId("trouble"), text ?? "");
}

async function askFigures() {
  const reply = await fetch(`/api/v1/runs/${encodeURIComponent(page.run)}/figures`);
  if (!reply.ok) throw new Error(`HTTP ${reply.status}`);
  return reply.json();
}
let early = askFigures(); // on its way while the rest of the page begins
early.catch(() => {}); // told when it is needed
let plotted; // to be called when a recording is drawn, or there is none
const firstPlot = new Promise((done) => { plotted = done; });

/** A recording is drawn before its state is known: to make that of thousands of messages takes longer. */
async function drawEarly() {
  const { outline } = await early;
  if (!outline || page.everConnected) { plotted(); return; }
  Object.assign(page.state, outline);
  page.t_s = outline.replay.last_utc_s;
  drawFigures();
}

/** Figures for what the run measures; made once, and again only where another run takes this name. */
async function drawFigures() {
  const wanted = JSON.stringify([page.state.graphs, page.state.signals]);
  if (drawn === wanted || !page.state.graphs) return;
  drawn = wanted;
  try {
    const made = await (early ?? askFigures());
    early = null;
    await placeFigures(made);
  } catch (error) {
    drawn = early = null;
    trouble(t("trouble.figures", { why: error.message })); // never a silent "no plot"
    setTimeout(drawFigures, BEGIN_AGAIN_ms);
  }
}

async function placeFigures(made) {
  const look = { palettes: made.palettes, looks: made.looks };
  const shown = page.state.graphs.filter((graph) => !isOfBench(graph));
  const live = shown.map((graph) => new LiveGraph(graph, page.state.graphs.indexOf(graph), look));
  const history = new HistoryGraph(shown.length ? shown : page.state.graphs, look);
  const temperature = new TemperatureGraph(look, live.length % 2 === 0); // beside an odd graph there is room
  graphs = [...live, temperature, history];
  page.history = history;
  byId("graphs").replaceChildren(...graphs.map((graph) => graph.card.element));
  if (page.state.replay) await soon(history.draw(made.history).then(painted)); // what one looks at first
  plotted();
  await Promise.all(live.map((graph) => graph.draw(made.graphs[graph.number])));
  for (const graph of live) graph.points(ring);
  draw(() => { if (ring.count) document.documentElement.dataset.firstPoints ??= Math.round(performance.now()); }); // ms since the page was asked for
  trouble(null);
  await temperature.draw(made.temperature);
  if (!history.card.figure) await history.draw(made.history);
}

/** When what waits to be drawn is on the screen. */
const painted = () => new Promise((done) => draw(() => requestAnimationFrame(() => setTimeout(done))));

/** Waits for something, but not for long. */
const soon = (task) => Promise.race([task, new Promise((done) => setTimeout(done, SOON_ms))]);

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
  drawEarly().catch(plotted); // told when the state is there
  greet().then((found) => { page.person = found; showCommands(); });
  wireCommands();
  wirePrompt();
  byId("log-filter").addEventListener("input", showLog);
  byId("log-severity").addEventListener("change", showLog);
  await soon(firstPlot); // the state of a recording takes the server longer
  const connection = new Connection(`/ws?run=${encodeURIComponent(page.run)}`, ring);
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
