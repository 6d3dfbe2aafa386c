// The start page: what runs now, the sessions of the folder, the calibration history.
import { byId, fillTable, icon, make, say } from "./dom.js";
import { onSettings } from "./settings.js";
import { greet, wireKeys, wireSettings } from "./shell.js";
import { loadTexts, t, word } from "./texts.js";
import { stamp } from "./time.js";

const AT_ONCE = 50;
const EVERY_ms = 5000;
const LIVING = ["starting", "running", "holding", "ending", "lost"];
let runs = [];
let calibrations = [];
let shown = AT_ONCE;

const address = (run) => `/runs/${encodeURIComponent(run)}`;
const unitOf = (run) => [run.uut?.model, run.uut?.serial].filter(Boolean).join(" ");

function living() {
  const found = runs.filter((run) => LIVING.includes(run.state));
  byId("living").replaceChildren(...(found.length ? found.map((run) => make("a", { href: address(run.run) },
    make("span", { class: "head" }, icon(run.state), word("state", run.state), run.simulated ? t("page.simulated") : ""),
    make("strong", { class: "name" }, run.title || run.run), make("span", { class: "soft" }, `${unitOf(run)} \u00b7 ${stamp(run.started_utc_s)}`)))
    : [make("p", { class: "soft" }, t("start.no-living"))]));
}

function sessions() {
  const wanted = byId("search").value.trim().toLowerCase().split(/\s+/).filter(Boolean);
  const found = runs.filter((run) => {
    const text = [run.run, run.title, unitOf(run), run.verdict, word("state", run.state), stamp(run.started_utc_s)].join(" ").toLowerCase();
    return wanted.every((one) => text.includes(one));
  });
  const columns = [["started", "fixed"], ["run", ""], ["unit", "fixed"], ["state", "fixed"], ["verdict", "fixed"], ["records", "number"]]
    .map(([name, look]) => ({ head: t(`start.${name}`), class: look }));
  const rows = found.slice(0, shown).map((run) => ({
    key: run.run,
    cells: [stamp(run.started_utc_s), link(run), unitOf(run), word("state", run.state), run.verdict ? word("verdict", run.verdict) : "–",
      recordsOf(run)],
  }));
  fillTable(byId("sessions"), columns, rows, t(wanted.length ? "start.no-match" : "start.no-sessions"));
  say(byId("found"), t("start.found", { shown: rows.length, found: found.length }));
  byId("more").hidden = found.length <= shown;
}

/** Done and planned; what is not known is a dash, so that no planned number passes for a done one. */
function recordsOf({ records }) {
  const [done, planned] = [records?.done ?? null, records?.planned ?? null];
  return done === null && planned === null ? "" : `${done ?? "\u2013"} / ${planned ?? "\u2013"}`;
}

function link(run) {
  return make("span", {}, make("a", { href: address(run.run) }, run.title || run.run),
    make("span", { class: "soft" }, ` ${run.run}${run.simulated ? ` \u00b7 ${t("page.simulated")}` : ""}`));
}

function history() {
  byId("no-calibrations").hidden = calibrations.length > 0;
  byId("calibrations").hidden = !calibrations.length;
  if (!calibrations.length) return;
  const columns = ["started", "unit", "campaign", "session", "method", "verdict", "estimates", "revision", "approved"]
    .map((name) => ({ head: t(`calibration.${name}`), class: ["estimates", "revision"].includes(name) ? "number" : name === "session" ? "" : "fixed" }));
  const here = new Set(runs.map((run) => run.run));
  const rows = calibrations.map((one) => ({
    key: `${one.session} ${one.session_sha256} ${one.revision}`,
    cells: [stamp(Date.parse(one.started_utc) / 1000), [one.uut_model, one.uut_serial].filter(Boolean).join(" "), one.campaign,
      calibrated(one, here.has(one.session)), one.method ?? "", one.verdict ? word("verdict", one.verdict) : "–", one.estimates ?? "", one.revision ?? "",
      (one.approved_by ?? []).join(", ")],
  }));
  fillTable(byId("calibrations"), columns, rows, "");
}

/** The session of a calibration, as a link where it is in this folder. */
function calibrated(one, here) {
  const name = here ? make("a", { href: address(one.session) }, one.session) : one.session;
  return make("span", {}, name, one.simulated ? make("span", { class: "soft" }, ` \u00b7 ${t("page.simulated")}`) : "");
}

async function ask(path, name) {
  const reply = await fetch(path);
  if (!reply.ok) throw new Error(`HTTP ${reply.status}`);
  const found = await reply.json();
  return Array.isArray(found) ? found : found[name] ?? [];
}

async function refresh() {
  if (document.hidden) return;
  try {
    runs = await ask("/api/v1/runs", "runs");
    byId("trouble").hidden = true;
  } catch {
    byId("trouble").hidden = false;
    say(byId("trouble"), t("trouble.server"));
    return;
  }
  living();
  sessions();
}

async function begin() {
  wireSettings();
  wireKeys();
  await loadTexts();
  await greet();
  byId("search").addEventListener("input", () => { shown = AT_ONCE; sessions(); });
  byId("more").addEventListener("click", () => { shown += AT_ONCE; sessions(); });
  onSettings((what) => { if (what === "time") { living(); sessions(); history(); } });
  await refresh();
  calibrations = await ask("/api/v1/calibrations", "calibrations").catch(() => []);
  history();
  setInterval(refresh, EVERY_ms);
  document.addEventListener("visibilitychange", refresh);
}

begin();
