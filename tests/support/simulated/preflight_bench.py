"""A bench for tests of the pre-flight: a plan on a station that is not in this process, fake instruments, a machine."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.model.clock import NS, Clock, VirtualClock
from bench.model.errors import InstrumentError
from bench.model.lab import find_shipped
from bench.model.ports import Identity
from bench.plan import Plan, compile_sequence, load_station
from bench.plan.served import served_station
from bench.run.preflight.context import Host, KernelClock, PreflightContext

TODAY = date(2026, 3, 1)
NOON_NS = 1_772_366_400 * NS  # 2026-03-01T12:00:00Z


@lru_cache
def in_process_plan() -> Plan:
    return compile_sequence(find_shipped("sequences", "scale_factor_short"), None, {})


@lru_cache
def served_plan() -> Plan:
    """The same plan on a station whose instruments are in another process; nothing is there to be opened."""
    station = load_station(find_shipped("stations", "af_bench_sim"))
    resources = {role: f"TCPIP0::127.0.0.1::hislip{n},1::INSTR" for n, role in enumerate(station.instruments)}
    urls = {link: f"no-such-device-{link}" for link in station.links}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "station.yaml"
        path.write_text(served_station(station, resources, urls, Path(folder) / "control.sock", TODAY))
        return compile_sequence(find_shipped("sequences", "scale_factor_short"), load_station(path), {})


class Instrument:
    """Says who it is, and whatever else a test gives it."""

    def __init__(self, identity: Identity | None, **answers: Any) -> None:
        self.identity = identity
        for name, answer in answers.items():
            setattr(self, name, answer)

    def identify(self) -> Identity:
        raise no_answer()


def no_answer() -> InstrumentError:
    return InstrumentError("B-INST-001", "no answer to '*IDN?' within 1 s", where="calibrator")


def refuses() -> Any:
    raise no_answer()


def calls(value: Any) -> Callable[[], Any]:
    return lambda: value


@dataclass
class Machine(Host):
    """A machine by what its files hold and its programs print."""

    files: Mapping[str, str] = field(default_factory=dict)
    folders: Mapping[str, Sequence[str]] = field(default_factory=dict)
    programs: Mapping[str, str] = field(default_factory=dict)
    clock: KernelClock | None = None
    newest_ns: int | None = None
    open_files: int | None = 1024
    file_bytes: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)

    def text(self, path: str) -> str | None:
        return self.files.get(path)

    def names(self, folder: str) -> list[str]:
        return list(self.folders.get(folder, ()))

    def exists(self, path: str) -> bool:
        return path in self.files or path in self.folders

    def terminal(self, descriptor: int | None) -> str:
        return self.files.get(f"terminal {descriptor}", "")

    def output(self, words: Sequence[str], limit_s: float = 5.0) -> str | None:
        return self.programs.get(Path(words[0]).name)

    def kernel_clock(self) -> KernelClock | None:
        return self.clock

    def most_open_files(self) -> int | None:
        return self.open_files

    def largest_file_bytes(self) -> int | None:
        return self.file_bytes

    def version(self, package: str) -> str | None:
        return self.versions.get(package)

    def newest_change_utc_ns(self, folder: Path) -> int | None:
        return self.newest_ns


def clock_at_noon() -> VirtualClock:
    return VirtualClock(NOON_NS)


def context(out: Path, *, plan: Plan | None = None, clock: Clock | None = None, **changes: Any) -> PreflightContext:
    """A bench of which nothing is open unless ``changes`` say so."""
    made = PreflightContext(
        plan=plan or served_plan(), clock=clock or clock_at_noon(), out=out, instruments={}, links={}, host=Machine()
    )
    return replace(made, **changes)
