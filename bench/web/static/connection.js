// The websocket: it comes back by itself, asks for a snapshot where something is missing, and says when it is gone.
import { mergePatch, readBatch } from "./points.js";
import { page, tell } from "./state.js";

export const PROTO = 1;
const FIRST_WAIT_ms = 250;
const LONGEST_WAIT_ms = 5000;
const SILENCE_ms = 10_000; // a socket that says nothing for so long is dead, whatever the browser thinks
const REFUSED = { 4401: "trouble.login", 4403: "trouble.origin", 4404: "trouble.unknown-run" };

export class Connection {
  /** path: of the socket with its query; ring: takes the points, null where none are shown. */
  constructor(path, ring) {
    this.address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${path}`;
    this.ring = ring;
    this.wait_ms = FIRST_WAIT_ms;
    this.timer = null;
    this.socket = null;
    this.patches = null; // number of the last delta
    this.boot = null;
    this.asked = false;
    addEventListener("online", () => this.#soon());
    document.addEventListener("visibilitychange", () => { if (!document.hidden) this.#soon(); });
    setInterval(() => this.#watch(), 1000);
    this.#open();
  }

  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  #open() {
    clearTimeout(this.timer);
    this.timer = null;
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.opened_ms = performance.now();
    socket.onmessage = (event) => { if (socket === this.socket) this.#take(event.data); };
    socket.onclose = (event) => { if (socket === this.socket) this.#closed(event.code); };
  }

  #closed(code) {
    page.connected = false;
    this.patches = null;
    tell("connection", { trouble: REFUSED[code] ?? null });
    if (REFUSED[code]) return; // trying again would not help
    const wait_ms = this.wait_ms * (0.75 + 0.5 * Math.random());
    this.wait_ms = Math.min(this.wait_ms * 2, LONGEST_WAIT_ms);
    this.timer = setTimeout(() => this.#open(), wait_ms);
  }

  /** Try at once: the network is back, or somebody looks again. */
  #soon() {
    if (this.timer !== null) { this.wait_ms = FIRST_WAIT_ms; this.#open(); }
  }

  #watch() {
    const now = performance.now();
    const quiet_ms = Math.min(now - page.heard_ms, now - this.opened_ms);
    if (this.timer !== null || quiet_ms < SILENCE_ms || !this.socket || this.socket.readyState > 1) return;
    const dead = this.socket;
    this.#closed(1006);
    dead.onclose = dead.onmessage = null;
    dead.close();
  }

  #snapshot() {
    if (this.asked) return;
    this.asked = true;
    this.send({ type: "snapshot" });
  }

  #take(message) {
    page.heard_ms = performance.now();
    if (typeof message !== "string") { this.#points(message); return; }
    const heard = JSON.parse(message);
    if (heard.type === "snapshot") this.#begin(heard);
    else if (heard.type === "delta") this.#delta(heard);
    else if (heard.type === "heartbeat") { page.age_s = heard.age_s; page.t_s = heard.t_utc_s; tell("heartbeat", heard); }
  }

  #begin(snapshot) {
    if (snapshot.state.proto !== PROTO) { tell("connection", { trouble: "trouble.proto" }); return; }
    this.wait_ms = FIRST_WAIT_ms;
    this.asked = false;
    this.patches = snapshot.seq;
    this.boot = snapshot.state.boot_id;
    page.state = snapshot.state;
    page.age_s = 0;
    page.connected = page.everConnected = true;
    this.ring?.begin((snapshot.state.signals ?? []).length);
    tell("connection", { trouble: null });
    tell("snapshot", page.state);
    tell("state", page.state);
  }

  #delta(heard) {
    if (this.patches === null) return;
    if (heard.seq !== this.patches + 1 || (heard.patch.boot_id ?? this.boot) !== this.boot) { this.#snapshot(); return; }
    this.patches = heard.seq;
    page.state = mergePatch(page.state, heard.patch);
    tell("state", page.state);
  }

  #points(buffer) {
    if (this.patches === null || !this.ring) return;
    if (!this.ring.add(readBatch(buffer))) { this.#snapshot(); return; }
    tell("points", this.ring);
  }
}
