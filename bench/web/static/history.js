// Questions to the history of a run: the newest one counts, an older one is given up.
import { pick } from "./curves.js";
import { readHistory } from "./wire.js";
import { page } from "./state.js";

export class History {
  #asking = null;
  trouble = ""; // what the server said when it could not answer

  /**
   * Rows between two instants with at most n buckets, or null: a newer question took its place, or `trouble` says why.
   * Args: signals: names, and factors of their values if any; t0_s, t1_s: seconds since 1970; n: buckets.
   */
  async ask({ signals, factors = null }, t0_s, t1_s, n) {
    this.#asking?.abort();
    const asking = new AbortController();
    this.#asking = asking;
    const query = new URLSearchParams({ signals: signals.join(","), t0: t0_s, t1: t1_s, n: Math.round(n) });
    try {
      const reply = await fetch(`/api/v1/runs/${encodeURIComponent(page.run)}/history?${query}`, { signal: asking.signal });
      if (reply.ok) {
        this.trouble = "";
        const rows = readHistory(await reply.arrayBuffer());
        return factors ? pick(rows, signals.map((_, column) => column), factors) : rows;
      }
      this.trouble = (await reply.json().catch(() => ({}))).text ?? `HTTP ${reply.status}`;
      return null;
    } catch {
      return null; // given up, or the server is gone: what is drawn stays, and the head of the page says how old it is
    } finally {
      if (this.#asking === asking) this.#asking = null;
    }
  }

  get busy() { return this.#asking !== null; }
}

/** First and last instant of the run, seconds since 1970. */
export function runSpan(newest_s) {
  const { state } = page;
  const first_s = state.replay?.first_utc_s ?? state.started_utc_s;
  const last_s = state.replay?.last_utc_s ?? Math.max(newest_s || -Infinity, state.t_utc_s ?? -Infinity);
  return { first_s, last_s: Math.max(last_s, first_s + 1) };
}
