"""What a person meets at the terminal while a run goes on, and the command line itself."""

import ast
import io
import os
import sys
from dataclasses import replace
from importlib import import_module
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer.main
from plan_sample import planned
from rehearsal import Inside
from rich.console import Console
from top_sample import NOW_S, FakeFeed, SetClock, document

import bench
from bench.analysis import Analysis, Estimate, Table, documents, estimate
from bench.cli import app, open_streams
from bench.commands import progress as progress_module
from bench.commands.check import settings_of
from bench.commands.conducting import TerminalOperator
from bench.commands.console import console
from bench.commands.progress import LOOK_EVERY_S, Follower, PlainLines, ProgressBar, doing
from bench.commands.tables import print_results, print_summary
from bench.commands.usage import GROUPS, completing
from bench.model.errors import BenchError
from bench.plan import Step
from bench.run.control.client import FeedGone
from bench.run.operator import Question

PLAN: Any = SimpleNamespace(steps=(None,) * 9, record_count=100, prepare_s=10.0, duration_s=90.0, finally_s=0.0)


def test_a_terminal_that_hangs_up_and_a_reader_that_goes_away_cost_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    (ours, theirs), (read, write) = os.openpty(), os.pipe()
    with os.fdopen(theirs, "w") as terminal, os.fdopen(write, "w") as pipe:
        monkeypatch.setattr(sys, "stderr", terminal)
        monkeypatch.setattr(sys, "stdout", pipe)
        open_streams()
        assert (sys.stderr.isatty(), sys.stdout.isatty()) == (True, False)
        console(stderr=True).print("heard")
        assert os.read(ours, 99) == b"heard\r\n"
        os.close(ours)
        os.close(read)
        for _ in range(2):
            console(stderr=True).print("not heard")
            console().print("x" * 99_999)


def step(kind: str, **fields: Any) -> Step:
    arguments = {"temperature": 50.0} if kind == "soak" else {}
    return planned(kind, 3, **{"role": "switch", "name": "route", **arguments, **fields})


def record(lost: int = 0, **conditions: Any) -> Any:
    return SimpleNamespace(lost=lost, window=SimpleNamespace(conditions=conditions))


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the person at the terminal will type, line by line; then the input ends."""
    lines: list[str] = []

    def read(prompt: str) -> str:
        if not lines:
            raise EOFError
        return lines.pop(0)

    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr("builtins.input", read)
    return lines


def test_an_answer_is_asked_for_until_it_is_clear(typed: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    typed += ["", "perhaps", "YES", "a little", "3", "3 V", "0.2 kohm"]
    assert TerminalOperator().ask(Question("door closed?", "operator")).by == "operator"
    capsys.readouterr()
    assert TerminalOperator().ask(Question("resistance?", unit="ohm")).value == 200.0
    assert len(capsys.readouterr().err.splitlines()) >= 4
    assert typed == []


@pytest.mark.parametrize("unit", ["", "ohm"])
@pytest.mark.parametrize("answer", [["stop"], []])
def test_a_refusal_or_nobody(monkeypatch: pytest.MonkeyPatch, typed: list[str], unit: str, answer: list[str]) -> None:
    typed += answer
    with pytest.raises(BenchError) as caught:
        TerminalOperator().ask(Question("ready?", unit=unit))
    assert caught.value.code == "B-CLI-006"
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    with pytest.raises(BenchError) as caught:
        TerminalOperator().ask(Question("ready?"))
    assert caught.value.code == "B-CLI-005"


@pytest.mark.parametrize("text", ["[/dev/ttyUSB0]", "limits [0 A, 220 mA]", ":on: GPIB0::4::INSTR", "[bold]x[/red]"])
def test_texts_that_look_like_markup_are_printed_as_they_are(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    console(stderr=True).print(text)
    assert capsys.readouterr().err == text + "\n"
    console(stderr=True).print("word " * 100)
    assert capsys.readouterr().err.count("\n") == 1


def test_plain_lines_tell_soaks_prompts_and_every_50th_record(capsys: pytest.CaptureFixture[str]) -> None:
    with PlainLines(PLAN, console()) as lines:
        lines.step(step("soak", conditions={"temperature_degC": -10.0}), 3661.0)
        lines.step(step("call"), 3662.0)
        for number in range(1, 101):
            lines.record(record(lost=2 if number == 100 else 0))
        lines.message("[careful]")
    said = capsys.readouterr().out.splitlines()
    assert said[0].split() == ["1:01:01", "step", "4/9", "soak", "-10", "degC"]
    assert said[1:] == ["record 50/100", "record 100/100, 2 frames lost", "[careful]"]


def test_the_progress_bar_takes_everything(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(PLAN, console(stderr=True)) as bar:
        bar.step(step("soak", conditions={"label": "[x]"}), 50.0)
        bar.record(record(lost=3))
        bar.record(record(purpose="wiring"))  # none of the campaign
        bar.message("[careful]")
    said = capsys.readouterr().err
    assert "[careful]" in said
    assert "1/100 records, 3 lost" in said


def test_settings() -> None:
    assert settings_of(["a=1 V", "b = x=y "]) == {"a": "1 V", "b": "x=y"}
    for wrong in ("a", "=1", ""):
        with pytest.raises(BenchError, match="B-CLI-001: "):
            settings_of([wrong])


def on(kind: str, what: str, **wait: Any) -> dict[str, Any]:
    step = {**document()["step"], "kind": kind, "what": what}
    return document(step=step, wait={"reason": what, "since_utc_s": NOW_S - 40, "until_utc_s": NOW_S + 60, **wait})


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (document(), "step 4123/9170  soak 50 degC: 48.2 degC, +0.4 degC/min, 0:12:40 of 0:30:00"),
        (document(wait=None), "step 4123/9170  soak 50 degC"),
        (on("record", "record 50 degC channel 3 +10 mA", last="x"),
         "step 4123/9170  record 50 degC channel 3 +10 mA, 0:00:40 of 0:01:40"),
        (on("call", "calibrator.warm_up", last="*OPC? -> ", until_utc_s=None),
         "step 4123/9170  calibrator.warm_up: *OPC? -> , 0:00:40"),
        (document(holds={"kim": "door opened", "interlock hot": "70 degC"}, wait={"since_utc_s": NOW_S - 5}),
         "HOLDING, 0:00:05: door opened (kim); 70 degC (interlock hot)"),
    ],
)  # fmt: skip
def test_what_is_going_on(found: dict[str, Any], words: str) -> None:
    assert doing(found) == words


def test_a_quiet_log_shows_that_the_run_lives(capsys: pytest.CaptureFixture[str]) -> None:
    clock: Any = SetClock()
    lines = PlainLines(PLAN, console(), clock)
    told: Any = SimpleNamespace(look=document)
    said = []
    for minute in range(61):
        clock.s = 60.0 * minute
        lines.sign_of_life(told)
        said += [minute] * len(capsys.readouterr().out.splitlines())
    assert said
    assert max(later - before for before, later in zip([0, *said], [*said, 60], strict=True)) < 10
    clock.s += 600.0
    lines.sign_of_life(told)
    words = "1:00:00  38 %  step 4123/9170  soak 50 degC: 48.2 degC, +0.4 degC/min, 0:12:40 of 0:30:00; "
    assert capsys.readouterr().out == f"{words}0/100 records, 7 lost, 3 bad; ends 11-19 11:26Z, latest 12:00Z\n"
    for minute in range(30):
        clock.s += 60.0
        if minute % 5 == 0:
            lines.message("x")
        lines.sign_of_life(told)
    assert set(capsys.readouterr().out.split()) == {"x"}  # a log that is not quiet needs no sign


@pytest.mark.parametrize(
    ("waiting", "said"),
    [
        ({"holds": {"instrument dmm": "B-INST-001: no answer"}}, "B-INST-001: no answer (instrument dmm)"),
        ({"holds": {"interlock disk": "disk_time is 60 s"}}, "disk_time is 60 s (interlock disk)"),
        ({"prompt": {"id": "1"}, "wait": {"reason": "answer: is the door closed?"}}, "answer: is the door closed?"),
    ],
)
def test_while_it_waits_for_disk_instrument_or_person_it_says_so_each_half_minute(
    capsys: pytest.CaptureFixture[str], waiting: dict[str, Any], said: str
) -> None:
    clock: Any = SetClock()
    lines = PlainLines(PLAN, console(), clock)
    told: Any = SimpleNamespace(look=lambda: document() | waiting)
    for moment in range(1, 5):
        clock.s = LOOK_EVERY_S * moment
        lines.sign_of_life(told)
    assert LOOK_EVERY_S == 30.0
    assert capsys.readouterr().out.count(said) == 4


def test_nobody_answers_is_no_trouble(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    feed = FakeFeed(document())

    def poll(since: int, state: bool = True) -> Any:
        if feed.silent:
            raise FeedGone("B-RUN-100", "gone")
        return feed.poll(since, state)

    monkeypatch.setattr(progress_module, "FeedClient", lambda folder: SimpleNamespace(poll=poll, close=lambda: None))
    follower = Follower(None)  # type: ignore[arg-type]
    assert follower.look() is not None
    feed.document["step"] = None  # the run has not begun yet
    assert follower.look() is None
    feed.silent = True
    assert follower.look() is None
    clock: Any = SetClock()
    lines = PlainLines(PLAN, console(), clock)
    clock.s = 6000.0
    lines.sign_of_life(follower)
    assert capsys.readouterr().out == ""
    assert feed.asked == [0, 360]
    follower.close()


UNITS = Table(
    "Units tested", "", ["unit", "failed", "verdict"], [["GNC-01", "–", "PASS"], ["GNC-02", "memory", "FAIL"]],
    prose=True, lead=True,
)  # fmt: skip
TABLE_3 = Table(
    "Table 3", "", ["parameter", "measured", "verdict"],
    [["overload", "–", "not tested"], ["gyro stability", "6.1 ± 0.5", "PASS"], ["range", "–", "not tested"]], lead=True,
)  # fmt: skip


def one(quantity: str, value: float, expanded: float, unit: str = "A", verdict: str = "none", **where: Any) -> Estimate:
    entry = estimate(quantity, unit, value, expanded / 2.0, where, n=1)
    return entry.model_copy(update={"expanded_uncertainty": expanded, "verdict": verdict})


def summarised(estimates: list[Estimate]) -> str:
    sheet = io.StringIO()
    print_summary(Console(file=sheet, width=110), "bias_ramp of NGU 7", estimates, 20.0)
    return " ".join(sheet.getvalue().split())


def test_a_summary_shows_values_at_the_reference_temperature_and_counts_the_rest() -> None:
    text = summarised(
        [
            one("bias", 368.0e-9, 0.8e-9, channel=1, temperature_degC=-10.0),
            one("bias", 436.57e-9, 0.49e-9, channel=1, temperature_degC=20.0),
            one("bias_residual", -11.5e-9, 0.05e-9, verdict="conditional_fail", channel=1),
            one("bias", -260.2e-9, 0.37e-9, channel=10, temperature_degC=20.0),
            one("master_clock_error", 1.9, 3.4, "ppm", temperature_degC=20.0),
        ]
    )
    for words in ("436.57 ± 0.49", "conditional fail", "−260.20 ± 0.37", "master_clock_error 1.9 ± 3.4 ppm"):
        assert words in text
    assert "368" not in text
    text = summarised([one("supply_current", 0.493478, 0.0, unit="A"), one("bias", 3e-7, 1e-9, unit="A")])
    assert "supply_current 0.493478 A" in text  # not in nanoampere, and no uncertainty is no zero
    assert "bias 300.0 ± 1.0 nA" in text
    text = summarised([one("up_minus_down", 1.0, 0.1, "ppm", reading=f"meter {k}") for k in range(30)])
    assert text.count("up_minus_down") == 24
    assert "6 more in results.json" in text


def printed(*tables: Table) -> str:
    estimates = [one(f"q{number}", 1.0, 0.1, "1", "pass", serial="GNC-01") for number in range(99)]
    uut = {"model": "GNC", "serial": "B-1"}
    results = {
        "campaign": "gnc_unit_test", "uut": uut, "provenance": {"simulated": True}, "estimates": documents(estimates),
        "quality": {"records": 0, "frames": 291, "frames_bad": 0, "frames_lost": 0, "retaken": 0},
    }  # fmt: skip
    sheet = io.StringIO()
    analysis = Analysis("gnc_unit_test", "exchanges", uut, estimates, tables=list(tables))
    print_results(Console(file=sheet, width=110), results, analysis)
    return " ".join(sheet.getvalue().split())


def test_tables_that_lead_are_printed_and_what_is_left_out_is_counted() -> None:
    text = printed(UNITS)
    assert "GNC-02 memory FAIL" in text
    assert "verdicts: 99 pass; 99 values with their uncertainties in results.json" in text
    text = printed(TABLE_3)
    assert ("gyro stability" in text, "overload" in text, "2 rows not tested" in text) == (True, False, True)
    text = printed(replace(TABLE_3, rows=TABLE_3.rows[:1]))
    assert ("parameter" in text, "1 rows not tested" in text) == (False, True)
    text = printed(replace(UNITS, rows=[[f"U-{number:02}", "–", "PASS"] for number in range(30)]))
    assert ("U-23" in text, "U-24" in text, "6 more rows in the report" in text) == (True, False, True)


COMMAND = typer.main.get_command(app)


def test_each_command_hands_its_arguments_to_work_that_takes_them() -> None:
    folder, seen = Path(bench.__file__).parent, 0
    for file in (folder / "cli.py", *folder.glob("commands/**/*app.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            for given in (one for call in getattr(node, "decorator_list", ()) for one in getattr(call, "keywords", ())):
                if isinstance(node, ast.FunctionDef) and given.arg == "work":
                    work = getattr(import_module(f"bench.commands.{ast.literal_eval(given.value)}"), node.name)
                    signature(work).bind(**{one.arg: None for one in (*node.args.args, *node.args.kwonlyargs)})
                    seen += 1
    assert seen > 30


def test_every_command_stands_in_one_group() -> None:
    listed = [name for lines in GROUPS.values() for name in lines]
    assert sorted(listed) == sorted(COMMAND.commands)  # type: ignore[attr-defined]


def test_help_and_version_are_options_too_and_a_mistyped_command_is_guessed(inside: Inside) -> None:
    assert inside().stdout == inside("--help").stdout == inside("-h").stdout
    assert inside("--version").stdout == inside("version").stdout == f"{bench.__version__}\n"
    done = inside("rnu")
    assert done.returncode == 2
    assert "error B-CLI-011: " in done.stderr
    assert "'run'" in done.stderr


def test_units_and_actions_are_listed_by_what_they_begin_with(inside: Inside) -> None:
    assert "arcmin, arcsec, deg, rad" in inside("list", "units", "deg").stdout
    assert "current 0 A to 2.2 A" in inside("list", "actions", "fluke").stdout
    assert "bench list units" in inside("list", "units", "parsec").stderr


def test_codes_and_pages_are_explained_or_the_nearest_is_named(inside: Inside, monkeypatch: pytest.MonkeyPatch) -> None:
    assert inside("explain", "b-fit-001").stdout.startswith("B-FIT-001, exit status 2\nThe rows do not determine")
    assert "From pip to a first verdict" in inside("explain", "docs/tutorial.md").stdout
    assert ", tutorial, " in inside("explain", "pages").stderr
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    said, hint = inside("explain", "B-FIT-011x").stderr.splitlines()
    assert ("B-FIT-011" in said.partition("Next: ")[2], hint) == (True, "More of it: bench explain B-CLI-011")


def test_commands_names_and_paths_are_completed(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "benches").mkdir()
    (tmp_path / "bench.yaml").touch()
    (tmp_path / "notes.txt").touch()
    monkeypatch.chdir(tmp_path)
    assert completing("stations")("af_bench") == ["af_bench_sim"]
    assert completing("sequences")("bench") == ["bench.yaml", "benches/"]
    assert completing("frames")(f"{tmp_path}/b") == [f"{tmp_path}/bench.yaml", f"{tmp_path}/benches/"]
    assert completing("frames")("nowhere/") == []


def test_the_shell_is_told_how_to_complete(inside: Inside, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"_BENCH_COMPLETE": "complete_bash", "COMP_WORDS": "bench re", "COMP_CWORD": "1"}.items():
        monkeypatch.setenv(name, value)
    assert inside().stdout.split() == ["resume", "replay", "report", "recover"]
    monkeypatch.setenv("COMP_WORDS", "bench run timeline_")
    monkeypatch.setenv("COMP_CWORD", "2")
    assert inside().stdout.split() == ["timeline_example"]
