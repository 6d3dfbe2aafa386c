"""A running ``bench sim`` for tests: its process, stock VISA sessions, its terminals, its state and faults."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyvisa
import serial

from bench.frame import LinkDecoder, load_frame
from bench.model.clock import WallClock
from bench.model.shipped import find_shipped
from bench.plan import load_station
from bench.run.bench.served_world import ask

CLOCK = WallClock()
SEED = 3
FRAMES = {"port_a": "ngu_a", "port_b": "ngu_b"}


class Served:
    """A running ``bench sim``: its folder, its process, VISA sessions by role."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.folder = folder
        command = [sys.executable, "-m", "bench", "sim", *words, "--clean", "--dir", str(folder)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert self.process.stdout is not None
        self.said = []
        for line in self.process.stdout:
            self.said.append(line.strip())
            if line.strip() == "ready":
                break
        else:
            raise AssertionError("\n".join(self.said))
        self.manager = pyvisa.ResourceManager("@py")
        self.station = load_station(folder / "station.yaml")
        self._sessions: dict[str, Any] = {}

    def __getitem__(self, role: str) -> Any:
        if role not in self._sessions:
            address = self.station.instruments[role].resource
            session = self.manager.open_resource(address, read_termination="\n", write_termination="\n")
            session.timeout = 1000
            self._sessions[role] = session
        return self._sessions[role]

    def fault(self, *words: str) -> list[str]:
        """What is on after switching; the command ``bench sim fault`` does no more than this, and prints it."""
        reply = ask(self.folder / "control.sock", words)
        assert "error" not in reply, reply
        return list(reply["lines"])

    def state(self) -> dict[str, Any]:
        return dict(ask(self.folder / "control.sock", ["state"])["state"])

    def until(self, true: Callable[[dict[str, Any]], bool], what: str, limit_s: float = 20.0) -> None:
        """Wait for something the state of the bench will say."""
        end_ns = CLOCK.now_ns() + round(limit_s * 1e9)
        while not true(self.state()):
            assert CLOCK.now_ns() < end_ns, f"never came: {what}"
            CLOCK.sleep(0.05)

    def cpu_s(self) -> float:
        """CPU seconds the process has used."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def listen(self, link: str, seconds: float) -> Any:
        """Counts of the frames of a link over some seconds."""
        decoder = LinkDecoder(load_frame(find_shipped("frames", FRAMES[link])))
        with serial.Serial(str(self.folder / link), timeout=0.05, exclusive=True) as port:
            end_ns = CLOCK.now_ns() + round(seconds * 1e9)
            while CLOCK.now_ns() < end_ns:
                decoder.push(CLOCK.now_ns(), port.read(100_000))
        decoder.flush()
        return decoder.counts

    def end(self, number: int = signal.SIGTERM) -> int:
        for session in self._sessions.values():
            session.close()
        self._sessions.clear()
        self.manager.close()
        self.process.send_signal(number)
        status = self.process.wait(20)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return status


def powered_rack(folder: Path) -> Served:
    """``af_rack_sim`` with its unit powered and streaming, and a 3458A that ends its replies."""
    served = Served(folder, "af_rack_sim", "--seed", str(SEED))
    for command in ("VOLT 18", "CURR 2", "OUTP ON"):
        served["supply"].write(command)
    served["dmm"].write("END ALWAYS")
    served.until(lambda state: sum(state["link_bytes"]["port_a"].values()) > 0, "the first frame of the unit")
    return served
