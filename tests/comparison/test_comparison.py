"""The comparison of two revisions: a tree beside itself is identical, and a change is told by name."""

import json
from pathlib import Path

import pytest
from cases import RUNS, Case, checks, golden_sessions, plans
from documents import compare_folders, named_differences
from revisions import HERE, ROOT, Bench, compare

GOLDEN_FIT = "fit_0.1.0_golden_GOLDEN"
FEW = {"gnc_unit_test", GOLDEN_FIT, "check_resistance_thermometer", "plans_own_checks"}


def few_cases() -> list[Case]:
    runs = [run.of(ROOT) for run in RUNS]
    cases = [*runs, *golden_sessions(ROOT / "tests" / "golden"), *plans(ROOT), *checks(ROOT)]
    return [case for case in cases if case.name in FEW]


@pytest.mark.slow
def test_a_tree_beside_itself_is_identical(tmp_path: Path) -> None:
    sides = [Bench(ROOT, tmp_path / side) for side in ("base", "new")]
    for side in sides:
        side.work.mkdir()
        side.check_imports()
    names = named_differences(HERE / "differences.toml")
    compared = list(compare(sides, few_cases()))
    assert {case.name for case, _ in compared} == FEW
    told = [difference for _, differences in compared for difference in differences]
    assert [difference for difference in told if not any(name.covers(difference) for name in names)] == []
    state = next((sides[0].work / "gnc_unit_test" / "out").glob("*/live_state.json"))
    assert json.loads(state.read_text())["session"]["outcome"]
    steps = json.loads((sides[0].work / "plans_own_checks" / "linearity.plan.json").read_text())
    assert steps[0]["number"] == 0


def test_every_shipped_sequence_and_every_example_is_checked() -> None:
    names = {case.name for case in checks(ROOT)}
    shipped = {f"check_{path.stem}" for path in ROOT.glob("sequences/*.yaml")}
    assert names == shipped | {f"check_{path.stem}" for path in ROOT.glob("examples/*/sequences/*.yaml")}
    assert {case.name for case in plans(ROOT)} >= {"plans_shipped", "plans_own_checks", "plans_lab_folder"}


def told(base: Path, new: Path) -> list[tuple[str, str, str, str]]:
    return [(found.file, found.place, found.base, found.new) for found in compare_folders(base, new)]


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    base, new = tmp_path / "base" / "case", tmp_path / "new" / "case"
    for folder in (base, new):
        folder.mkdir(parents=True)
    return base, new


def test_a_page_is_compared_by_its_text(folders: tuple[Path, Path]) -> None:
    base, new = folders
    (base / "report.html").write_text("<p class=a>scale factor</p><p>12 ppm</p><style>p {}</style>")
    (new / "report.html").write_text("<div><b>scale  factor</b></div><p>12 ppm</p>")
    assert told(base, new) == []
    (new / "report.html").write_text("<p>serial 7</p><p>scale factor</p><p>13 ppm</p>")
    assert told(base, new) == [
        ("report.html", "line 1", "(absent)", "'serial 7'"), ("report.html", "line 2", "'12 ppm'", "'13 ppm'"),
    ]  # fmt: skip


def test_a_document_is_compared_by_its_fields(folders: tuple[Path, Path]) -> None:
    base, new = folders
    (base / "live_state.json").write_text('{"state": "done", "log": [1, 2]}')
    (new / "live_state.json").write_text('{"state": "done", "log": [1, 3]}')
    (new / "more.txt").write_text("x")
    assert told(base, new) == [
        ("live_state.json", "log[1]", "2", "3"), ("more.txt", "file", "(absent)", "there"),
    ]  # fmt: skip
