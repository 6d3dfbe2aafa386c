"""A served bench and who works at it: stock VISA sessions to its instruments, a listener at its terminals."""

import os
import signal
from pathlib import Path
from typing import Any

import pyvisa
import serial
from served import Served as ServedProcess

from bench.frame import LinkDecoder, load_frame
from bench.model.clock import WallClock
from bench.model.lab import find_shipped
from bench.plan import load_station

CLOCK = WallClock()
SEED = 3
FRAMES = {"port_a": "ngu_a", "port_b": "ngu_b"}


class Served(ServedProcess):
    """A running ``bench sim`` with VISA sessions by role; ``station`` is loaded."""

    station: Any

    def __init__(self, folder: Path, of: str, *words: str) -> None:
        super().__init__(folder, *words, of=of)
        self.manager = pyvisa.ResourceManager("@py")
        self.station = load_station(self.station)
        self._sessions: dict[str, Any] = {}

    def __getitem__(self, role: str) -> Any:
        if role not in self._sessions:
            address = self.station.instruments[role].resource
            session = self.manager.open_resource(address, read_termination="\n", write_termination="\n")
            session.timeout = 1000
            self._sessions[role] = session
        return self._sessions[role]

    def send(self, role: str, *messages: str) -> None:
        """Send messages that have no reply."""
        for message in messages:
            self[role].write(message)

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
        """Close the sessions and end it; return its exit status."""
        for session in self._sessions.values():
            session.close()
        self._sessions.clear()
        self.manager.close()
        return self.close(number)


def powered_rack(folder: Path) -> Served:
    """``af_rack_sim`` with its unit powered and streaming, and a 3458A that ends its replies."""
    served = Served(folder, "af_rack_sim", "--seed", str(SEED))
    served.send("supply", "VOLT 18", "CURR 2", "OUTP ON")
    served.send("dmm", "END ALWAYS")
    served.until(lambda state: sum(state["link_bytes"]["port_a"].values()) > 0, "the first frame of the unit")
    return served
