"""First contact with an instrument: every simulated model passes, and one that refuses, or keeps silent, does not."""

import json
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.model.clock import VirtualClock
from bench.model.drivers import Manual, manual_of
from bench.model.errors import InstrumentError
from bench.model.ports import Identity
from bench.plan import Findings, check_station, load_station
from bench.run.bus.first_contact import Tried, record_of, unproved, walk, write_record
from bench.run.bus.opener import open_bench
from bench.run.observers import HeldTranscript
from sim_instruments import krohn_hite_3988, thermotron_3800

ROOT = Path(__file__).parents[2]
WHO = Identity("MAKER", "M1", "7", "2.0")
MANUAL = Manual.model_validate(
    {
        "instrument": "A source",
        "sources": {"guide": "its guide"},
        "commands": {
            "OUTP ON": {"source": "guide", "touch": "energises", "try": "OUTP ON"},
            "FORM ASC": {"source": "guide", "touch": "sets", "try": "FORM ASC"},
            "VOLT?": {"source": "guide", "reply": "NUMBER", "try": "VOLT?"},
            "MODE? {n}": {"source": "guide", "state": "unconfirmed", "reply": "A|B", "try": "MODE? 1"},
            "ERR?": {"source": "guide", "state": "unconfirmed", "reply": "0", "try": "ERR?"},
            "READ?": {"source": "guide", "reply": "NUMBER"},
        },
    }
)


class Fake:
    """An instrument whose numbers are binary until it is told otherwise; ``said`` what it was sent."""

    def __init__(self, **replies: str) -> None:
        self.replies = {"VOLT?": "#14....", "MODE? 1": "A", "ERR?": "0", **replies}
        self.said, self.problems, self.options = list[str](), list[str](), dict[str, str]()

    def raw(self, command: str, *, answers: bool = False) -> str | None:
        self.said.append(command)
        if command == "FORM ASC":
            self.replies["VOLT?"] = "1.25E+00"
        if "?" in command and self.replies[command] == "mute":
            raise InstrumentError("B-INST-001", "no answer")
        return self.replies.get(command)

    def drain_errors(self) -> list[str]:
        found, self.problems = self.problems, []
        return found

    def make_safe(self) -> None:
        self.said.append("safe")


def outcomes(tried: list[Tried]) -> dict[str, str]:
    return {one.form: one.outcome for one in tried}


@pytest.mark.parametrize("answer", [True, False])
def test_harmless_commands_come_first_and_somebody_is_asked_before_the_output_is_on(answer: bool) -> None:
    fake, asked = Fake(), []

    def ask(text: str) -> bool:
        asked.append(text)
        return answer

    tried = walk(fake, MANUAL, ask, lambda one: None)
    dangerous = ["OUTP ON", "safe"] if answer else []
    assert fake.said == ["VOLT?", "MODE? 1", "ERR?", "FORM ASC", *dangerous, "VOLT?"]
    assert len(asked) == 1
    assert "OUTP ON" in asked[0]
    assert outcomes(tried) == {
        "VOLT?": "as documented", "MODE? {n}": "as documented", "ERR?": "as documented", "READ?": "not tried",
        "FORM ASC": "as documented", "OUTP ON": "as documented" if answer else "not tried",
    }  # fmt: skip


def test_what_differs_is_silent_or_refused_is_told() -> None:
    fake = Fake(**{"MODE? 1": "C", "ERR?": "mute"})
    seen: list[Tried] = []
    tried = walk(fake, MANUAL, lambda text: False, seen.append)
    assert outcomes(tried)["MODE? {n}"] == "differs"
    assert outcomes(tried)["ERR?"] == "no answer"
    fake.problems = ["-113 Undefined header"] * 3
    again = walk(fake, MANUAL, lambda text: False, seen.append)[0]
    (refused,) = [one for one in seen if one.outcome == "refused"]
    assert (refused.said, again.outcome) == ("1.25E+00; -113 Undefined header (3 times)", "as documented")
    assert len(seen) > len(tried)


def test_a_command_whose_answer_was_lost_is_tried_once_more() -> None:
    fake = Fake(**{"ERR?": "mute"})
    seen: list[Tried] = []

    def tell(one: Tried) -> None:
        seen.append(one)
        if one.form == "FORM ASC":
            fake.replies["ERR?"] = "0"

    tried = walk(fake, MANUAL, lambda text: False, tell)
    assert [one.outcome for one in seen if one.form == "ERR?"] == ["no answer", "as documented"]
    assert outcomes(tried)["ERR?"] == "as documented"
    assert fake.said.count("ERR?") == 2


@pytest.mark.parametrize(
    ("change", "left"),
    [
        ({}, []),
        ({"driver": "another"}, ["MODE? {n}", "ERR?"]),
        (
            {"identity": {"manufacturer": "MAKER", "model": "M1", "serial": "7", "firmware": "2.1"}},
            ["MODE? {n}", "ERR?"],
        ),
        ({"identity": {"manufacturer": "MAKER", "model": "M1", "serial": "8", "firmware": "2.0"}}, []),
    ],
)
def test_a_record_counts_for_its_driver_model_and_firmware(tmp_path: Path, change: dict[str, Any], left: Any) -> None:
    tried = walk(Fake(), MANUAL, lambda text: False, lambda one: None)
    record = record_of("source", "m1", WHO, "somebody", "2026-01-02T03:04:05Z", tried) | change
    written = record_of(
        "source", record["driver"], Identity(**record["identity"]), "somebody", "2026-01-02T03:04:05Z", tried
    )
    path = write_record(tmp_path / "station.yaml", written)
    assert unproved(tmp_path / "station.yaml", "m1", MANUAL, WHO) == left
    assert path.name == "source_20260102T030405Z.json"
    assert "| `MODE? {n}` | `MODE? 1` | `A` | `A\\|B` | as documented |" in path.with_suffix(".md").read_text()


def test_a_record_that_somebody_changed_proves_nothing(tmp_path: Path) -> None:
    tried = walk(Fake(**{"MODE? 1": "C"}), MANUAL, lambda text: False, lambda one: None)
    path = write_record(tmp_path / "station.yaml", record_of("source", "m1", WHO, "somebody", "2026-01-02Z", tried))
    assert unproved(tmp_path / "station.yaml", "m1", MANUAL, WHO) == ["MODE? {n}"]
    record = json.loads(path.read_text())
    for one in record["commands"]:
        one["outcome"] = "as documented"
    path.write_text(json.dumps(record))
    assert unproved(tmp_path / "station.yaml", "m1", MANUAL, WHO) == ["MODE? {n}", "ERR?"]
    path.write_text("[]")
    assert unproved(tmp_path / "station.yaml", "m1", MANUAL, WHO) == ["MODE? {n}", "ERR?"]


OPEN = {  # what is never sent alone, or on a serial line only
    "agilent_34401a": {"SYST:REM"},
    "agilent_e3631a": {"SYST:REM"},
    "agilent_34970a": {"FRES:NPLC? {channels}", "CONF:FRES {range},{channels}", "FRES:NPLC {cycles},{channels}"},
    "agilent_53230a": {"READ?"},
    "acutrol_3000": {":mode:pos {axis}"},
    "hp_3458a": {"TRIG SGL"},
    "pendulum_cnt_91": {"STR:DATA? {bytes}"},
    "hp_6632b": {"OUT 0"},
}


def met(station: str, roles: Collection[str]) -> Iterator[tuple[str, list[Tried]]]:
    """Yield driver and outcome of first contacts with instruments of a simulated bench, in this process."""
    bench = load_station(ROOT / "stations" / f"{station}.yaml")
    among = roles or [*bench.instruments]
    opened = open_bench(bench, VirtualClock(), HeldTranscript(), seed=1, links=False, roles=among)
    try:
        for role, instrument in opened.instruments.items():
            instrument.introduce()  # type: ignore[attr-defined]
            driver = bench.instruments[role].driver
            yield driver, walk(instrument, manual_of(driver), lambda _: True, lambda _: None)  # type: ignore[arg-type]
    finally:
        opened.close()


@pytest.mark.parametrize("station", ["af_bench_sim", "af_rack_sim", "fog_bench_sim", "rlg_bench_sim"])
def test_every_simulated_model_passes(station: str) -> None:
    for driver, tried in met(station, ()):
        wrong = {form for form, outcome in outcomes(tried).items() if outcome != "as documented"}
        assert wrong == OPEN.get(driver, set()), [one for one in tried if one.form in wrong]


@pytest.mark.parametrize("station", ["af_bench_sim", "af_rack_sim"])
def test_a_chamber_that_does_not_know_a_command_does_not_pass(station: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A 3800 passes it over in silence, an 8800 tells completion 2."""
    for word in ("MRMP", "HOLD", "SETP"):
        monkeypatch.delitem(thermotron_3800._OPERATIONS, word)
    ((_, tried),) = met(station, ["chamber"])
    wrong = {form for form, outcome in outcomes(tried).items() if outcome != "as documented"}
    assert wrong == {"MRMP1,{ramp}", "HOLD", "SETP1,{temperature}"}


def test_a_filter_that_tells_its_name_alone_does_not_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    carried_out = krohn_hite_3988.KrohnHite3988.execute
    only_v = lambda self, message: carried_out(self, message) if message.strip() == "V" else None  # noqa: E731
    monkeypatch.setattr(krohn_hite_3988.KrohnHite3988, "execute", only_v)
    ((driver, tried),) = met("fog_bench_sim", ["filter"])
    assert [one.outcome for one in tried] == ["as documented"] + ["no answer"] * 5
    record = record_of("filter", driver, WHO, "somebody", "2026-01-02Z", tried)
    write_record(tmp_path / "station.yaml", record)
    manual = manual_of(driver)
    assert manual is not None
    assert unproved(tmp_path / "station.yaml", driver, manual, WHO) == [*manual.commands][1:]


def test_what_is_never_sent_alone_and_unconfirmed_keeps_the_gate_shut(tmp_path: Path) -> None:
    commands = {"X": {"source": "guide", "state": "unconfirmed"}}
    manual = Manual.model_validate({"instrument": "A source", "sources": {"guide": ""}, "commands": commands})
    assert unproved(tmp_path / "station.yaml", "m1", manual, WHO) == ["X"]


def test_a_fault_is_that_of_the_command_that_made_it() -> None:
    fake = Fake(**{"MODE? 1": "mute"})
    fake.problems = ["-113 Undefined header"]
    tried = {one.form: one for one in walk(fake, MANUAL, lambda text: False, lambda one: None)}
    assert (tried["ERR?"].outcome, tried["MODE? {n}"].outcome) == ("as documented", "no answer")


def test_the_table_of_a_driver_of_the_lab_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "instruments").mkdir()
    (tmp_path / "bench.toml").write_text('[lab]\nname = "Ours"\n')
    (tmp_path / "instruments" / "own.py").write_text("DRIVER = object\n")
    (tmp_path / "instruments" / "own.yaml").write_text("{instrument: Own, sources: {}, commands: {}}")
    monkeypatch.chdir(tmp_path)
    assert manual_of("own") == Manual(instrument="Own", sources={}, commands={})
    (tmp_path / "instruments" / "away.py").write_text("DRIVER = object\n")
    row = "{source: g, when: [mesure], why: x}"
    (tmp_path / "instruments" / "away.yaml").write_text(
        f"{{instrument: A, sources: {{g: G}}, commands: {{}}, states: {{terminals: {row}}}}}"
    )
    (tmp_path / "s.yaml").write_text(
        "{station: s, simulated: false, visa: '@py', links: {}, instruments: {meter: {driver: away, "
        "resource: 'GPIB0::1::INSTR', safe_order: 1}}}"
    )
    check_station(load_station(tmp_path / "s.yaml"), findings := Findings())
    assert "'terminals' waits for 'mesure'" in "; ".join(error.message for error in findings.all())
    assert manual_of("hp_3458a") is not None
