"""Sessions of years for the archive: units that come back, two benches, a check standard on each.

A unit has its constants each time it comes back, and so has the check standard on channel 7 of each bench; noise is
another one. The calibrator of the bench ``a`` has a wrong certificate from 2001 on: its register corrects a gain of
60 ppm that the calibrator does not have. Everything else is as it should be. A session takes a third of a second.
"""

import functools
import json
import os
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from rehearsal import writable_copy
from run_rig import Listener

from bench.analysis import results_json
from bench.commands.run import view_of
from bench.model.clock import NS, VirtualClock
from bench.plan import Plan, compile_sequence, load_station
from bench.record import SessionReader, SessionWriter
from bench.run.operator import SimulatedOperator
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
    return compile_sequence(sequence, load_station(station), {"world.unit_seed": str(int(serial.removeprefix("U-")))})


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
    path.write_text(f"certificates:\n  {WRONG}:\n{entry[1]}\n")
    return path


def concerned(campaigns: Sequence[Campaign]) -> set[str]:
    """Return the sessions that the wrong certificate concerns."""
    return {entry.name for entry in campaigns if entry.bench == "a" and entry.day.year >= WRONG_YEAR}


def sha256_of(folder: Path) -> str:
    """Return the hash of a session, by its results."""
    return str(json.loads((folder / "results.json").read_text())["provenance"]["session_sha256"])


GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "sessions" / "0.1.0"
OTHER = GOLDEN / "20000101T000000Z_golden_rlg_GOLDEN"
SEGMENT, RESULTS, OPEN = "session.0001.mcap", "results.json", "session.open"
LOCKED = "locked"  # may not be listed
Spoil = Callable[[Path], object]


def of_bytes(change: Callable[[bytes], bytes], name: str = SEGMENT) -> Spoil:
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def of_results(change: Callable[[dict[str, Any]], object]) -> Spoil:
    def spoil(folder: Path) -> None:
        document = json.loads((folder / RESULTS).read_text())
        change(document)
        (folder / RESULTS).write_text(json.dumps(document))

    return spoil


def alter(document: dict[str, Any]) -> None:
    document["estimates"][0]["value"] *= 1.0 + 1e-7


def _all(*spoils: Spoil) -> Spoil:
    return lambda folder: [spoil(folder) for spoil in spoils]


def _flip(at: int) -> Spoil:
    return of_bytes(lambda raw: raw[:at] + bytes([raw[at] ^ 0xFF]) + raw[at:][1:])


def gone(name: str) -> Spoil:
    return lambda folder: (folder / name).unlink()


def _instead(name: str, make: Callable[[Path], object]) -> Spoil:
    return _all(gone(name), lambda folder: make(folder / name))


def _linked(name: str) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / name).rename(folder / f"real.{name}")
        (folder / name).symlink_to(f"real.{name}")

    return spoil


def _only(*names: str) -> Spoil:
    def spoil(folder: Path) -> None:
        for path in folder.iterdir():
            if path.name not in names:
                path.unlink()

    return spoil


def _opened(folder: Path) -> None:
    (folder / OPEN).touch()


def _recorded(error: str | None) -> Spoil:
    """A session of a few events, whose run ended or was stopped."""

    def spoil(folder: Path) -> None:
        source = SessionReader(folder)
        manifest, texts, end = source.manifest, source.texts, next(fields for _, _, fields in source.events("end"))
        shutil.rmtree(folder)
        writer = SessionWriter.create(folder, manifest, texts, t_mono_ns=0)
        writer.event("end", 1, {**end, "error": error})
        writer.close("done" if error is None else error)

    return spoil


CUT, END_CUT = of_bytes(lambda raw: raw[:60_000]), of_bytes(lambda raw: raw[:-3000])
SHORT, WRONG_KINDS = "damaged B-ARC-004", "damaged B-REC-011"
UNREADABLE, UNFINISHED = "unreadable B-ARC-007", "unfinished B-STORE-013"
# What a folder is, by what was done to a whole session: the kind, and the code of one that is not whole.
KINDS: Mapping[str, tuple[Spoil, str]] = {
    "whole": (lambda _: None, "entered"),
    "no_results": (gone(RESULTS), "entered"),
    "linked": (_all(_linked(SEGMENT), _linked(RESULTS)), "entered"),
    "open_by_a_copy": (_opened, "entered"),
    "with_a_trend": (lambda folder: (folder / "trend").mkdir(), "entered"),
    "strange ünicode ' name": (lambda _: None, "entered"),
    "done_without_results": (_recorded(None), "entered"),
    "cut": (CUT, SHORT),
    "cut_early": (of_bytes(lambda raw: raw[:1000]), SHORT),
    "empty": (of_bytes(lambda _: b""), SHORT),
    "cut_with_broken_results": (_all(CUT, of_bytes(lambda _: b"{", RESULTS)), SHORT),
    "cut_and_nothing_says_more": (_all(CUT, gone(RESULTS)), "damaged B-STORE-013"),
    "end_cut": (END_CUT, WRONG_KINDS),
    "flipped": (_flip(50_000), WRONG_KINDS),
    "flipped_manifest": (_flip(400), WRONG_KINDS),
    "flipped_summary": (_flip(-100), WRONG_KINDS),
    "appended": (of_bytes(lambda raw: raw + b"more"), WRONG_KINDS),
    "zeroed": (of_bytes(lambda raw: raw[:50_000] + bytes(500) + raw[50_500:]), WRONG_KINDS),
    "second_gone": (lambda folder: (folder / SEGMENT).rename(folder / "session.0002.mcap"), WRONG_KINDS),
    "broken_results": (of_bytes(lambda _: b"{", RESULTS), "damaged B-FIT-010"),
    "provenance": (of_results(lambda document: document.update(provenance="")), "damaged B-FIT-010"),
    "foreign_results": (lambda folder: shutil.copy(OTHER / RESULTS, folder), "damaged B-STORE-013"),
    "altered": (of_results(alter), "entered"),  # verify computes it
    "pipe": (_instead(SEGMENT, os.mkfifo), UNREADABLE),
    "results_pipe": (_instead(RESULTS, os.mkfifo), UNREADABLE),
    "dead_link": (_instead(SEGMENT, lambda path: path.symlink_to("/no/such/file")), UNREADABLE),
    "bad\udcffname": (lambda _: None, UNREADABLE),
    LOCKED: (lambda _: None, UNREADABLE),
    "running": (_all(_recorded(None), END_CUT, _opened), UNFINISHED),
    "killed": (_all(CUT, gone(RESULTS), _opened), UNFINISHED),
    "stopped": (_recorded("B-RUN-010"), "stopped B-STORE-013"),
    "results_only": (_only(RESULTS), "no_recording"),
    "marker_only": (_all(_only(), _opened), "no_recording"),
    "nothing": (_only(), "no_recording"),
}
COMPUTED = (
    "altered",
    "broken_results",
    "provenance",
    "foreign_results",
)  # beside those entered: the recording is whole
ALTERED = "damaged B-ARC-008"


def make(root: Path, sessions: Sequence[Path], count: int) -> dict[str, tuple[str, str]]:
    """Make ``count`` folders and a link, some of them deep; returns name of the session and what it is, by folder."""
    due, kinds = {}, list(KINDS)
    for number in range(count):
        session, kind = sessions[number % len(sessions)], kinds[number % len(kinds)]
        name = f"{number:03d} {kind}"
        KINDS[kind][0](writable_copy(session, root / ("deep/er" if number % 2 else "flat") / name))
        due[name.replace("\udcff", "\\xff")] = session.name, kind
    (root / "link").symlink_to(sessions[0])
    return due
