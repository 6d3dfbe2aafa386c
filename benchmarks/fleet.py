"""What the fleet page costs: processor of ``bench serve --fleet`` with 200 benches and the pages that look at them.

One process plays all benches over real sockets: each has a port and a token of its own, a heartbeat each 2 s at a phase
of its own, and something new to say each 10 s. Viewers are clients of the websockets library that take whatever comes.
Processor time of the server is that of /proc/<pid>/stat, so other programs on the machine change it little.

Measured (python -m benchmarks.fleet 60) on two cores that other programs used too:

    0 viewers: 1.6 % of a core        1 viewer: 1.7 %, sent 3.0 messages/s, 1.2 kB/s        3 viewers: 1.7 %
    three killed, two cut off, 3 viewers: 1.4 %        memory: 88 MB

Run: python -m benchmarks.fleet [SECONDS [BENCHES]]
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from bench.model.clock import NS, WallClock, pause
from bench.web.security.logins import Cookies, Login
from bench.web.security.tokens import obtain_tokens

BENCHES = 200
BEAT_S, NEWS_S = 2.0, 10.0
TICKS = os.sysconf("SC_CLK_TCK")
CLOCK = WallClock()
ALARM = {"severity": "alarm", "code": "B-LINK-003", "text": "port_a: no byte for 30 s"}
KINDS: tuple[dict[str, Any], ...] = (
    {"state": "running", "attention": "none", "waits": "soak 55 degC"},
    {"state": "running", "attention": "none", "what": "record, channel 3, 10 mA"},
    {"state": "running", "attention": "none", "what": "ramp to -40 degC"},
    {"state": "holding", "attention": "much", "waits": ALARM["text"], "alarm_count": 1, "alarms": [ALARM]},
    {"state": "waiting", "attention": "some", "asks": "Connect the unit to channel 3 of the matrix."},
    {},  # nothing runs
)
SHARES = (0.4, 0.3, 0.15, 0.02, 0.03, 0.1)  # of the benches


class Played:
    """One bench as it looks from outside."""

    def __init__(self, number: int) -> None:
        self.name, self.place = f"bench-{number}", f"room {1 + number // 12}.{number % 12:02}"
        self.token = f"{number:032}"
        self.port = 0
        self.is_cut = False
        self._random = np.random.default_rng(number)
        self._kind = KINDS[self._random.choice(len(KINDS), p=SHARES)]
        self._number = number
        self._progress = self._random.random()
        self.server: Server | None = None

    @property
    def state(self) -> str:
        """What the page should say of it."""
        return str(self._kind.get("state", "idle"))

    def document(self) -> dict[str, Any]:
        """What it says now."""
        run = f"20260301T0000{self._number % 60:02}Z_scale_factor_{self._number}"
        named = {"title": "Scale factor, 5 temperatures", "uut": {"model": "NGU", "serial": str(self._number)}}
        if not self._kind:
            return {
                "proto": 1,
                "runs": {},
                "last": {"run": run, **named, "outcome": "pass", "off": True, "attention": "none"},
            }
        self._progress = min(1.0, self._progress + 0.001)
        end_utc_s = CLOCK.utc_ns() / NS + 3600 * 30 * (1 - self._progress)
        card = {"outputs": "energised", "alarm_count": 0, "alarms": [], "simulated": False, **named, **self._kind}
        return {"proto": 1, "runs": {run: {**card, "progress": round(self._progress, 3), "end_utc_s": end_utc_s}}}

    async def answer(self, connection: ServerConnection) -> None:
        """Tell whoever has the token until it goes away; one that was cut off says nothing more."""
        if connection.request is None or connection.request.headers.get("Authorization") != f"Bearer {self.token}":
            await connection.close(4401, "B-WEB-024")
            return
        told_s = BEAT_S * int(self._random.integers(NEWS_S / BEAT_S))
        with suppress(ConnectionClosed):
            await pause(BEAT_S * self._random.random())
            await connection.send(json.dumps({"type": "snapshot", "seq": 0, "state": self.document()}))
            while True:
                await pause(BEAT_S)
                told_s += BEAT_S
                if self.is_cut:
                    await asyncio.Event().wait()
                if told_s >= NEWS_S:
                    told_s = 0.0
                    await connection.send(json.dumps({"type": "snapshot", "seq": 0, "state": self.document()}))
                else:
                    await connection.send(
                        json.dumps({"type": "heartbeat", "t_utc_s": CLOCK.utc_ns() / NS, "age_s": None})
                    )

    async def admit(self, connection: ServerConnection, request: object) -> None:
        """Let a connection in; one that was cut off lets it wait."""
        del connection, request
        if self.is_cut:
            await asyncio.Event().wait()


class Player:
    """Many benches in one thread of this process."""

    def __init__(self, count: int = BENCHES) -> None:
        self.benches = [Played(number + 1) for number in range(count)]
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        for bench in self.benches:
            self._do(self._open(bench))

    def _do(self, coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(20)

    async def _open(self, bench: Played) -> None:
        bench.server = await serve(
            bench.answer, "127.0.0.1", bench.port, process_request=bench.admit, compression=None, ping_interval=None
        )
        bench.port = next(iter(bench.server.sockets)).getsockname()[1]

    def kill(self, bench: Played) -> None:
        """What the kernel does when a process is killed: every connection ends, nobody listens."""

        async def kill() -> None:
            assert bench.server is not None
            bench.server.close(close_connections=False)
            for connection in bench.server.connections:
                connection.transport.abort()

        self._do(kill())

    def start(self, bench: Played) -> None:
        """Let a bench that was killed listen again on its port."""
        self._do(self._open(bench))

    def write(self, folder: Path) -> Path:
        """Write ``fleet.yaml`` and the files of the tokens; returns the first."""
        lines = ["benches:"]
        for bench in self.benches:
            token = folder / f"{bench.name}.token"
            token.touch(0o600)
            token.write_text(bench.token)
            lines.append(
                f"  - {{name: {bench.name}, place: '{bench.place}', url: 'http://127.0.0.1:{bench.port}', "
                f"token_file: {token.name}}}"
            )
        path = folder / "fleet.yaml"
        path.write_text("\n".join(lines) + "\n")
        return path

    def close(self) -> None:
        """End all of them."""

        for bench in self.benches:
            self.kill(bench)

        async def end() -> None:
            tasks = asyncio.all_tasks() - {asyncio.current_task()}
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

        self._do(end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class FleetServer:
    """``bench serve --fleet`` on a free port, and a viewer's cookie for it."""

    def __init__(self, fleet: Path, private: Path) -> None:
        words = [sys.executable, "-m", "bench", "serve", "--fleet", str(fleet), "--port", "0"]
        environment = {**os.environ, "XDG_CONFIG_HOME": str(private)}
        self.process = subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        found = re.search(r"http://127\.0\.0\.1:(\d+)/", self.process.stdout.readline())
        if found is None:
            raise SystemExit("bench serve --fleet did not start")
        self.origin = found[0].rstrip("/")
        tokens, _ = obtain_tokens(private / "inertial-bench")
        cookies = Cookies(tokens, CLOCK, int(found[1]), secure=False)
        self._headers = {"Cookie": cookies.header(Login("page", "viewer", "0")).partition(";")[0]}

    @contextmanager
    def watching(self) -> Iterator[ClientConnection]:
        """Open one page."""
        address = f"ws{self.origin.removeprefix('http')}/ws"
        with connect(
            address,
            origin=self.origin,
            additional_headers=self._headers,
            proxy=None,
            ping_interval=None,  # type: ignore[arg-type]
        ) as connection:
            yield connection

    def cpu_s(self) -> float:
        """Return processor time of the server so far, s."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS

    def memory_MB(self) -> float:
        """Return resident memory of the server."""
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def end(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait()


def measured(server: FleetServer, viewers: int, seconds: float) -> str:
    """Return the share of a core while so many look, and what one of them was sent."""
    counts, ended = [[0, 0] for _ in range(viewers)], threading.Event()

    def look(count: list[int]) -> None:
        with server.watching() as page:
            while not ended.is_set():
                with suppress(TimeoutError):
                    count[1] += len(page.recv(timeout=0.5))
                    count[0] += 1

    threads = [threading.Thread(target=look, args=(count,)) for count in counts]
    for thread in threads:
        thread.start()
    CLOCK.sleep(3.0)
    before, begun_s, begun_ns = [count[:] for count in counts], server.cpu_s(), CLOCK.now_ns()
    CLOCK.sleep(seconds)
    used_s, lasted_s = server.cpu_s() - begun_s, (CLOCK.now_ns() - begun_ns) / NS
    messages, letters = ([now[i] - then[i] for now, then in zip(counts, before, strict=True)] for i in (0, 1))
    ended.set()
    for thread in threads:
        thread.join()
    said = f"{viewers} viewers: {100 * used_s / lasted_s:.2f} % of a core in {lasted_s:.0f} s"
    if not viewers:
        return said
    return f"{said}, each sent {min(messages) / lasted_s:.1f} messages/s, {min(letters) / lasted_s / 1e3:.1f} kB/s"


def main(words: list[str]) -> int:
    """Print the figures."""
    seconds = float(words[0]) if words else 30.0
    player = Player(int(words[1]) if len(words) > 1 else BENCHES)
    with TemporaryDirectory() as top:
        server = FleetServer(player.write(Path(top)), Path(top))
        try:
            CLOCK.sleep(5.0)
            lines = [measured(server, viewers, seconds) for viewers in (0, 1, 3)]
            for bench in player.benches[:3]:
                player.kill(bench)
            for bench in player.benches[3:5]:
                bench.is_cut = True
            CLOCK.sleep(10.0)
            lines.append(f"three killed, two cut off, {measured(server, 3, seconds)}")
            sys.stdout.write("\n".join([*lines, f"memory: {server.memory_MB():.0f} MB"]) + "\n")
        finally:
            server.end()
            player.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
