"""Events are read back as written; errors, extras and shipped files: what a technician reads."""

import math
from dataclasses import MISSING, fields
from pathlib import Path

import pytest

from bench.model import errors, events, lab
from bench.model.errors import ExitStatus, InputError
from bench.model.events import Error, Event, Hold, Late, Record, Resume, event_of
from bench.model.extras import extras_named
from bench.model.lab import find_shipped, shipped_folder, shipped_names

RECORD = Record(
    number=1, link="port_a", first_counter=5, frames=100, t_start_ns=0, t_end_ns=9, conditions={"channel": 1}, step=3
)
MODELS = sorted(
    (model for model in vars(events).values() if isinstance(model, type) and issubclass(model, Event) and model.kind),
    key=lambda model: model.__name__,
)


@pytest.mark.parametrize(
    "event", [RECORD, Hold(step=1, by="kim", reason="door"), Error(code="B-X", text="t", where="w")]
)
def test_an_event_is_read_back_as_it_was_written(event: Event) -> None:
    again = event_of(event.kind, event.document())
    assert (again, again.raw) == (event, None)


def test_what_an_event_does_not_have_is_left_out_and_what_it_may_lack_is_null() -> None:
    assert set(RECORD.document()) == {
        "number", "link", "first_counter", "frames", "t_start_ns", "t_end_ns", "conditions", "step",
    }  # fmt: skip
    assert Hold(step=1, by="kim", reason="door", uut="SN 2").document()["uut"] == "SN 2"
    assert Resume(reason="x").document() == {"reason": "x", "stopped_utc_ns": None, "away_s": None, "unit_degC": None}


def test_a_number_that_was_none_comes_back_as_none() -> None:
    late = event_of("late", {"step": 2, "policy": "hold", "last_degC": None, "slope_degC_min": 0.5})
    assert isinstance(late, Late)
    assert math.isnan(late.last_degC)
    assert late.sentence == "step 2: not stable at the end of its slot, last none degC, +0.500 degC/min: hold"


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_no_event_of_a_foreign_session_is_refused(model: type[Event]) -> None:
    for document in ({}, {field.name: {"strange": [1]} for field in fields(model)}):
        event = model.read(document)
        assert (event.sentence, event.severity, event.topic) is not None
    lacks = any(field.default is MISSING and field.default_factory is MISSING for field in fields(model))
    assert (model.read({}).raw is not None) == lacks


def test_an_event_of_other_fields_or_of_another_kind_is_read() -> None:
    strange = event_of("retake", {"record": 2.5})
    assert (strange.unknown, strange.document()) == (("record", "reason"), {"record": -1, "reason": ""})
    whole = event_of("retake", {"record": 2.0, "reason": "x"})
    assert (whole.unknown, whole.document()) == ((), {"record": 2, "reason": "x"})
    event = event_of("something", {"a": 1})
    assert (type(event), event.sentence, event.raw) == (Event, "", {"a": 1})


def test_errors_say_code_place_message_and_next_step_a_line_each() -> None:
    error = errors.InputError("B-TEST-001", "10 mA is over 1 mA", where="a.yaml:1:2", next_step="lower it")
    assert str(error) == "error B-TEST-001: a.yaml:1:2: 10 mA is over 1 mA. Next: lower it"
    assert str(errors.InputError("B-TEST-001", "wrong")) == "error B-TEST-001: wrong"
    both = errors.InputErrors([errors.InputError("B-TEST-001", "one"), errors.InputError("B-TEST-002", "two")])
    assert str(both).splitlines() == ["error B-TEST-001: one", "error B-TEST-002: two"]
    assert both.code == "B-TEST-001"


@pytest.mark.parametrize(
    ("family", "status"),
    [
        (errors.InputError, 2),
        (errors.FitError, 2),
        (errors.InstrumentError, 3),
        (errors.LinkError, 3),
        (errors.RunError, 3),
        (errors.OperatorStop, 4),
        (errors.SessionDamaged, 5),
        (errors.BenchError, 70),
    ],
)
def test_exit_status_of_each_family(family: type[errors.BenchError], status: int) -> None:
    assert family.exit_status == status


def test_a_package_of_an_extra_is_named_with_it() -> None:
    with (
        pytest.raises(InputError, match=r"the live page needs bokeh, which is not installed") as caught,
        extras_named(),
    ):
        raise ModuleNotFoundError("No module named 'bokeh.plotting'", name="bokeh.plotting")
    assert caught.value.code == "B-PKG-005"
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    assert caught.value.next_step == "pip install 'inertial-bench[page]'"


def test_any_other_module_that_is_missing_stays_what_it_is() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module"), extras_named():
        import no_such_module  # noqa: F401


TOP = Path(__file__).resolve().parents[3]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package folder in a site-packages with one frame inside, and a current folder that is empty."""
    inside = tmp_path / "site" / "bench" / "shipped" / "frames"
    inside.mkdir(parents=True)
    (inside / "ngu_a.yaml").write_text("frame: ngu_a\n")
    monkeypatch.setattr(lab, "_PACKAGE", tmp_path / "site" / "bench")
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    return inside


def test_checkout_serves_its_own_folders() -> None:
    assert shipped_folder("frames") == TOP / "frames"


def test_installed_folder_goes_before_a_neighbour_of_the_package(package: Path) -> None:
    (package.parents[2] / "frames").mkdir()
    assert shipped_folder("frames") == package
    assert shipped_names("frames") == ["ngu_a"]


def test_path_goes_before_name(package: Path) -> None:
    Path("ngu_a.yaml").write_text("frame: mine\n")
    assert find_shipped("frames", "ngu_a.yaml").read_text() == "frame: mine\n"
    assert find_shipped("frames", "ngu_a") == package / "ngu_a.yaml"


@pytest.mark.parametrize("name", ["ngu_b", "../frames/ngu_a", "/ngu_a", "", ".", "ngu\0a", "x" * 5000], ids=range(7))
def test_nothing_of_that_name(package: Path, name: str) -> None:
    with pytest.raises(InputError) as caught:
        find_shipped("frames", name)
    assert caught.value.code == "B-SHIP-001"
    assert caught.value.exit_status == ExitStatus.BAD_INPUT
    assert "ngu_a" in caught.value.next_step


@pytest.mark.parametrize(
    ("kind", "name", "what", "taken"),
    [
        ("sequences", "vn100_binary", "this is a frame, and a sequence is due", "bench decode vn100_binary FILE"),
        ("sequences", "af_bench_sim", "this is a station, and a sequence is due", "--station af_bench_sim of"),
        ("sequences", str(TOP / "docs" / "mappings" / "tckit_1v_ramp.yaml"), "this is a mapping", "bench import"),
        ("stations", "ngu_a", "this is a frame, and a station is due", "a sequence names it under 'frame'"),
    ],
)
def test_another_kind_of_file_is_named_with_who_takes_it(kind: lab.Kind, name: str, what: str, taken: str) -> None:
    with pytest.raises(InputError, match=what) as caught:
        find_shipped(kind, name)
    assert (caught.value.code, caught.value.exit_status) == ("B-SHIP-002", ExitStatus.BAD_INPUT)
    assert taken in caught.value.next_step
