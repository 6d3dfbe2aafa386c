"""What tests find served: a bench, its faults and what it really does; controllers that run on it."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from waiting import until

from bench.run.bus.served_world import ask
from bench.run.guard.diary import read_diary

HERE = Path(__file__).resolve().parent
START_S = 60.0
SAFE_S = 5.0  # the deadline of safety


class Served:
    """``bench sim`` of the station ``of`` in a process; ``station`` is the station file that reaches it."""

    def __init__(self, folder: Path, *words: str, of: str = "af_rack_sim") -> None:
        self.folder, self.station = folder, folder / "station.yaml"
        self.said: list[str] = []
        command = [sys.executable, "-m", "bench", "sim", of, "--clean", "--dir", str(folder), *words]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said.append(line.strip())
            if line.strip() == "ready":
                break
        else:
            raise AssertionError("\n".join(self.said))

    def close(self, number: int = signal.SIGINT) -> int:
        """End it by a signal; return its exit status."""
        self.process.send_signal(number)
        status = self.process.wait(START_S)
        self.process.stdout.close()
        return status

    def fault(self, *words: str) -> list[str]:
        """Switch a fault; return what is on. The command ``bench sim fault`` does no more than this, and prints it."""
        reply = ask(self.folder / "control.sock", words)
        assert "error" not in reply, reply
        return list(reply["lines"])

    def state(self) -> dict[str, Any]:
        """What the bench really does at this moment."""
        return ask(self.folder / "control.sock", ["state"])["state"]

    def until(self, true: Callable[[dict[str, Any]], object], what: str) -> dict[str, Any]:
        """Wait for something that the bench really does; return its state."""
        return until(lambda: state if true(state := self.state()) else {}, what, each_s=0.02)

    def on(self) -> list[str]:
        """Roles whose stimulus or route is on."""
        instruments = self.state()["instruments"]
        return [
            *(["calibrator"] if instruments["calibrator"]["operating"] else []),
            *(["switch"] if instruments["switch"]["closed"] else []),
        ]

    def changed_s(self, *roles: str) -> float:
        """Monotonic time of this machine when an output of these roles last changed."""
        found = self.state()
        return max(float(found["time_s"] - found["instruments"][role]["unchanged_s"]) for role in roles)


@contextmanager
def serving(folder: Path, *words: str, of: str = "af_rack_sim") -> Iterator[Served]:
    """Serve a bench, and end it whatever happens."""
    served = Served(folder, *words, of=of)
    try:
        yield served
    finally:
        served.close()


class Controller:
    """A run on the served bench in a process of its own (tests/support/controller.py)."""

    def __init__(self, station: Path, sequence: Path, out: Path, *acts: str) -> None:
        self.out = out
        self.heard = ""
        command = [sys.executable, str(HERE / "controller.py"), str(station), str(sequence), str(out), *acts]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def wait_for(self, word: str) -> str:
        """The first line the controller says that holds ``word``."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.heard += line
            if word in line:
                return line
        raise AssertionError(f"{word!r} was not said, but: {self.heard}")

    @property
    def diary(self) -> list[dict[str, Any]]:
        """What the guard of this run did."""
        folders = sorted(self.out.glob("*/guard.jsonl"))
        return read_diary(folders[-1]) if folders else []

    @property
    def why(self) -> str:
        """Why the guard acted."""
        return str(next(entry["reason"] for entry in self.diary if entry["what"] == "act"))

    def wait_for_guard(self, *words: str) -> dict[str, Any]:
        """The guard's entry that is one of ``words``."""

        def noted() -> dict[str, Any]:
            return next((entry for entry in self.diary if entry["what"] in words), {})

        return until(noted, lambda: f"{words} in {self.diary}")

    def end(self) -> int:
        """Wait for its end; returns its status."""
        assert self.process.stdout is not None
        try:
            self.heard += self.process.stdout.read()
            return self.process.wait(START_S)
        finally:
            self.kill()

    def kill(self) -> None:
        if self.process.poll() is None:
            os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()
