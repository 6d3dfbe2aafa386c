"""Sessions of years for the archive: units that come back, two benches, a check standard on each.

A unit has its constants each time it comes back, and so has the check standard on channel 7 of each bench; noise is
another one. The calibrator of the bench ``a`` has a wrong certificate from 2001 on: its register corrects a gain of
60 ppm that the calibrator does not have. Everything else is as it should be. A session takes a third of a second.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path

from run_rig import Listener

from bench.analysis import results_json
from bench.commands.run import view_of
from bench.model.clock import NS, VirtualClock
from bench.plan import Plan, compile_sequence, load_station
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from bench.session.history import enter_history
from bench.session.view import KEPT_EVENTS, analyse_view

ROOT = Path(__file__).resolve().parents[2]
WRONG_ppm, WRONG_YEAR, RIGHT = 60, 2001, "C-a-2001-R"
WRONG = f"C-a-{WRONG_YEAR}"
CALIBRATOR = "CAL-a"


@dataclass(frozen=True)
class Campaign:
    """One session: which bench measured which unit on which day."""

    bench: str
    serial: str
    day: date

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.day:%Y%m%d}T000000Z_golden_{self.serial}"


def small() -> list[Campaign]:
    """Return eleven sessions: eight good ones of the bench ``a``, two with the wrong certificate, one of ``b``."""
    good = [Campaign("a", f"U-{number % 3 + 1}", date(2000, 2, 1) + timedelta(35 * number)) for number in range(8)]
    wrong = [Campaign("a", "U-1", date(2001, 1, 20)), Campaign("a", "U-2", date(2001, 2, 20))]
    return [*good, *wrong, Campaign("b", "U-3", date(2001, 2, 21))]


def many(count: int) -> list[Campaign]:
    """Return sessions of fifty units, a day apart, on two benches in turn, half of them with the wrong year."""
    first = date(WRONG_YEAR, 1, 1) - timedelta(count // 2)
    return [Campaign("ab"[n % 2], f"U-{n * 7 % 50 + 1:02d}", first + timedelta(n)) for n in range(count)]


def record(campaigns: Sequence[Campaign], out: Path) -> None:
    """Record sessions with their results into a folder, with the history beside them; those that are there stay."""
    for number, campaign in enumerate(campaigns):
        if not (out / campaign.name / "results.json").exists():
            _record(campaign, out, seed=number + 1)


def _record(campaign: Campaign, out: Path, seed: int) -> None:
    plan = _plan(out, campaign.bench, campaign.serial, campaign.day.year)
    began_ns = int(datetime.combine(campaign.day, time(), UTC).timestamp()) * NS
    done = conduct(
        plan, clock=VirtualClock(began_ns), seed=seed, out=out, operator=SimulatedOperator(), listener=Listener(),
        keep_events=KEPT_EVENTS,
    )  # fmt: skip
    assert done.outcome.error is None
    view = view_of(plan, done)
    results, _ = analyse_view(view)
    (done.folder / "results.json").write_text(results_json(results))
    assert enter_history(f"sqlite:///{out / 'history.sqlite'}", done.folder, results, done.manifest, None) is None


@functools.cache
def _plan(out: Path, bench: str, serial: str, year: int) -> Plan:
    """Return the smallest scale-factor campaign of a unit on a bench, with the certificates of a year."""
    made = out / "made"
    made.mkdir(exist_ok=True)
    station = made / f"bench_{bench}_{year}.yaml"
    station.write_text(station_text(bench, year))
    text = (ROOT / "tests" / "golden" / "sessions" / "golden.yaml").read_text()
    text = text.replace("serial: GOLDEN", f"serial: {serial}")
    check = f"check_standard: {{model: CS, serial: CS-{bench}, channel: 7}}\n"
    sequence = made / f"golden_{bench}_{serial}.yaml"
    sequence.write_text(check + text)
    return compile_sequence(sequence, load_station(station), {"world.unit_seed": str(_number_of(serial))})


def _number_of(serial: str) -> int:
    return int(serial.removeprefix("U-"))


def station_text(bench: str, year: int) -> str:
    """Return the simulated bench with standards of its own, calibrated at the beginning of a year."""
    text = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
    text = text.replace("station: af_bench_sim", f"station: bench_{bench}")
    text = text.replace("SIM5720", f"CAL-{bench}").replace("SIM-0001", f"C-{bench}-{year}")
    text = text.replace('"1999-11-01"', f'"{year - 1}-12-31"').replace('"2000-11-01"', f'"{year + 1}-01-31"')
    text = text.replace("age: 2160 h", "age: 9600 h")  # one calibration a year
    text = text.replace("calibrator_gain: \"on\"", f"calibrator_gain: \"off\"\n    unit_seed: null\n"
                        f"    check_standard: \"7:{900 + 'ab'.index(bench)}\"")  # fmt: skip
    if bench == "a" and year >= WRONG_YEAR:
        text = text.replace(f"C-a-{year}", WRONG).replace("gain: 0 ppm", f"gain: {WRONG_ppm} ppm")
    return text


def corrected(path: Path) -> Path:
    """Write the register file in which the wrong certificate is put right; returns its path."""
    text = station_text("a", WRONG_YEAR).replace(f"gain: {WRONG_ppm} ppm", "gain: 0 ppm").replace(WRONG, RIGHT)
    entry = re.search(r"  calibrator:.*?    standard:\n(.*?)\n\n", text, re.DOTALL)
    assert entry is not None
    path.write_text(f"certificates:\n  {WRONG}:\n{entry[1]}\n")
    return path


def concerned(campaigns: Sequence[Campaign]) -> set[str]:
    """Return the sessions that the wrong certificate concerns."""
    return {entry.name for entry in campaigns if entry.bench == "a" and entry.day.year >= WRONG_YEAR}


def sha256_of(folder: Path) -> str:
    """Return the hash of a session, by its results."""
    return str(json.loads((folder / "results.json").read_text())["provenance"]["session_sha256"])
