"""What the page server costs: processor with one and three viewers, memory with a viewer that does not read.

A feed in this process gives 20 signals, 10 points a second and a state that is another one at each question; the
server is ``bench serve``, a process of its own; viewers are clients of the websockets library in threads of this one.
Processor and memory of the server are those of /proc/<pid>; the history is asked over HTTP, of a session that is named.

Measured behind the loading of what the first page needs, on two cores:

    quiet: 1 viewer 0.9 to 1.1 % of a core, 3 viewers 1.2 % in two runs, 10.0 batches/s
    a viewer that does not read for 60 s: 95.4 MB at its start and at its end

and of a session of 38 h without a trend of its own (python -m benchmarks.page 12 SESSION): history of 25 h, 10 channels
25 s the first time (the trend is made then) and 20 ms from then on; 20 s of single readings 119 ms.

Run: python -m benchmarks.page [SECONDS [SESSION]]
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from websockets.sync.client import ClientConnection, connect

from bench.model.clock import NS, WallClock
from bench.record import SessionWriter
from bench.run.control.live import FeedServer
from bench.run.feed.points import PointBatch
from bench.web.security.logins import Cookies, Login
from bench.web.security.tokens import VIEWER, obtain_tokens

SIGNALS, POINTS_HZ, KEPT = 20, 10, 600
TICKS = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")
RUN = "20260101T000000Z_page_1"
T0 = 1_767_225_600.0
WARM_S = 8.0  # it loads what the first page will need, once, and that is not what a viewer costs


class Feed:
    """A run that makes points by the clock."""

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._start_ns = clock.now_ns()
        self._lines = [
            {"t_utc_s": T0, "kind": "reading", "text": "a line of some sixty letters, as they are in a log"}
        ] * 200

    def made(self) -> int:
        """Points so far; a minute of them is there from the start."""
        return KEPT + (self._clock.now_ns() - self._start_ns) * POINTS_HZ // NS

    def points(self, since: int) -> PointBatch:
        """Points from a number on."""
        made = self.made()
        first = max(since if since <= made else 0, made - KEPT)
        stamps = T0 + np.arange(first, made) / POINTS_HZ
        rng = np.random.default_rng(first)
        pairs = rng.normal(size=(len(stamps), SIGNALS, 2)).astype("<f4")
        return PointBatch(made, first, len(stamps), stamps.astype("<f8").tobytes() + pairs.tobytes())

    def state(self) -> dict[str, Any]:
        """A state in which time, progress, the links and the instruments change."""
        now = T0 + self.made() / POINTS_HZ
        link = {
            "state": "open",
            "reason": "",
            "frames": self.made() * 10,
            "bad": 0,
            "lost": 0,
            "rate_Hz": 100.0,
            "age_s": 0.01,
        }
        line = {"driver": "fluke_5720a", "command": "OUT?", "reply": f"{now:.3f}", "t_utc_s": now, "state": "ok"}
        return {
            "proto": 1, "run": RUN, "boot_id": "0" * 16, "title": "page", "state": "running", "source": "live",
            "t_utc_s": now, "progress": self.made() / 1e6, "records": {"done": 1, "planned": 9, "last": []},
            "log": self._lines,
            "links": {"port_a": link, "port_b": link}, "instruments": {f"role_{index}": line for index in range(14)},
            "signals": [{"name": f"port_a.npp[{index + 1}]", "unit": "1", "decimals": 0} for index in range(SIGNALS)],
        }  # fmt: skip


class Server:
    """``bench serve`` for a folder, on a free port."""

    def __init__(self, out: Path, private: Path, clock: WallClock) -> None:
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        environment = {**os.environ, "XDG_CONFIG_HOME": str(private)}
        tokens, clear = obtain_tokens(private / "inertial-bench")
        self.bearer = {"Authorization": f"Bearer {clear[VIEWER]}"}
        words = [sys.executable, "-m", "bench", "serve", "--out", str(out), "--port", str(self.port)]
        self.process = subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.process.stdout.readline()  # the address: it listens
        cookies = Cookies(tokens, clock, self.port, secure=False)
        self.headers = {"Cookie": cookies.header(Login("page", "viewer", "0")).partition(";")[0]}

    def cpu_s(self) -> float:
        """Processor time of the server so far, s."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS

    def memory_MB(self) -> float:
        """Resident memory of the server."""
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * PAGE / 1e6

    @contextmanager
    def watching(self, run: str = RUN) -> Iterator[ClientConnection]:
        """A viewer whose messages nobody has taken yet."""
        address, origin = f"ws://127.0.0.1:{self.port}/ws?run={run}", f"http://127.0.0.1:{self.port}"
        with connect(
            address, origin=origin, additional_headers=self.headers, proxy=None, max_size=None, max_queue=1,  # type: ignore[arg-type]
            ping_interval=None,
        ) as connection:  # fmt: skip
            yield connection

    def ask(self, path: str) -> bytes:
        """One GET."""
        connection = HTTPConnection("127.0.0.1", self.port)
        connection.request("GET", path, headers=self.headers)
        reply = connection.getresponse()
        content = reply.read()
        connection.close()
        if reply.status != 200:
            raise SystemExit(f"{path}: {reply.status} {content[:200]!r}")
        return content


def take(connection: ClientConnection, counts: dict[str, int], ended: threading.Event) -> None:
    """Read whatever comes."""
    while not ended.is_set():
        try:
            message = connection.recv(timeout=0.5)
        except TimeoutError:
            continue
        counts["batches" if isinstance(message, bytes) else "texts"] += 1


def viewers(server: Server, clock: WallClock, count: int, seconds: float) -> str:
    """Processor share of the server while so many look."""
    ended, counts = threading.Event(), [{"batches": 0, "texts": 0} for _ in range(count)]
    with _several(server, count) as connections:
        threads = [threading.Thread(target=take, args=(*one, ended)) for one in zip(connections, counts, strict=True)]
        for thread in threads:
            thread.start()
        clock.sleep(2.0)
        before_s, begun_ns, batches = server.cpu_s(), clock.now_ns(), min(one["batches"] for one in counts)
        clock.sleep(seconds)
        share = (server.cpu_s() - before_s) / ((clock.now_ns() - begun_ns) / NS)
        rate = (min(one["batches"] for one in counts) - batches) / ((clock.now_ns() - begun_ns) / NS)
        ended.set()
        for thread in threads:
            thread.join()
    return f"{count} viewers: {100 * share:.1f} % of a core, {rate:.1f} batches/s at least"


@contextmanager
def _several(server: Server, count: int) -> Iterator[list[ClientConnection]]:
    if not count:
        yield []
        return
    with server.watching() as one, _several(server, count - 1) as others:
        yield [one, *others]


def frozen(server: Server, clock: WallClock, seconds: float) -> str:
    """Memory of the server with a viewer that takes nothing."""
    with server.watching():
        clock.sleep(2.0)
        begin_MB = server.memory_MB()
        clock.sleep(seconds)
        return f"a viewer that does not read for {seconds:.0f} s: {begin_MB:.1f} MB, then {server.memory_MB():.1f} MB"


def first_history(server: Server, clock: WallClock, run: str) -> list[str]:
    """Time of the first and of the second history of a whole session, ten channels, and of 20 s of it."""
    state = clock.now_ns()
    server.ask(f"/api/v1/runs/{run}")
    lines = [f"state document: {(clock.now_ns() - state) / 1e6:.0f} ms"]
    names = ",".join(f"port_a.npp[{index + 1}]" for index in range(10)).replace("[", "%5B").replace("]", "%5D")
    first, last = 946_684_800.0, 946_684_800.0 + 25 * 3600
    spans = [("25 h", first, last), ("25 h again", first, last), ("20 s", first + 40_000, first + 40_019.9)]
    for what, t0, t1 in spans:
        begun_ns = clock.now_ns()
        content = server.ask(f"/api/v1/runs/{run}/history?signals={names}&t0={t0}&t1={t1}&n=1000")
        lines.append(f"history, 10 channels, {what}: {(clock.now_ns() - begun_ns) / 1e6:.0f} ms, {len(content)} bytes")
    return lines


@contextmanager
def serving(clock: WallClock, recorded: Path | None = None) -> Iterator[Server]:
    """A server that has begun with a living run, and with a recorded one if given, as ``recorded``."""
    with TemporaryDirectory() as top:
        out = Path(top) / "sessions"
        session = SessionWriter.create(out / RUN, {"session": RUN}, {}, t_mono_ns=0)
        feed = Feed(clock)
        head = {"proto": 1, "boot_id": "0" * 16, "signals": SIGNALS}
        feed_server = FeedServer(out / RUN / "live.sock", head, feed.state, feed.points)
        if recorded is not None:
            (out / "recorded").mkdir()
            for path in recorded.resolve().iterdir():
                (out / "recorded" / path.name).symlink_to(path)
        server = Server(out, Path(top), clock)
        try:
            clock.sleep(WARM_S)
            yield server
        finally:
            server.process.terminate()
            server.process.wait()
            feed_server.close()
            session.close("done")


def main(words: list[str]) -> int:
    """Print the figures."""
    seconds = float(words[0]) if words else 20.0
    clock = WallClock()
    with serving(clock, Path(words[1]) if len(words) > 1 else None) as server:
        lines = [viewers(server, clock, count, seconds) for count in (1, 3)]
        lines.append(frozen(server, clock, seconds))
        lines += first_history(server, clock, "recorded") if len(words) > 1 else []
        sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
