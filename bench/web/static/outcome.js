// A run that is over: how it ended, what it is worth, and what was written of it.
import { byId, icon, make } from "./dom.js";
import { page } from "./state.js";
import { t } from "./texts.js";
import { duration } from "./time.js";

const FILES = ["report", "pdf", "certificate", "specimen"];

function lines({ outcome, duration_s: lasted_s }) {
  const soundness = outcome.verdicts ? (outcome.doubtful ? t("outcome.unsound", { count: outcome.doubtful }) : t("outcome.sound")) : "";
  const off = outcome.off === null || outcome.off === undefined ? "" : t(outcome.off ? "outcome.off" : "outcome.not-off");
  return [[t("outcome.lasted", { duration: duration(lasted_s) }), soundness, off].filter(Boolean).join(" \u00b7 "), outcome.why].filter(Boolean);
}

export function showOutcome() {
  const element = byId("session-outcome");
  const { session } = page.state;
  element.hidden = !session;
  const mark = JSON.stringify(session ?? null);
  if (!session || element.dataset.mark === mark) return;
  element.dataset.mark = mark;
  element.dataset.outcome = session.outcome.word;
  const links = FILES.filter((name) => session.files[name]).map((name) => make("a", { class: "button", id: name,
    href: `/api/v1/runs/${encodeURIComponent(page.run)}/${name}` }, t(`outcome.${name}`)));
  element.replaceChildren(make("h2", { class: "unseen" }, t("outcome.title")), make("strong", { class: "outcome-word" }, icon(`outcome-${session.outcome.word}`), t(`outcome.${session.outcome.word}`)),
    make("div", {}, ...lines(session).map((line) => make("p", {}, line))), make("p", { class: "buttons" }, ...links));
}
