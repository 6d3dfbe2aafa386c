"""The repository as somebody else gets it: complete, clean locks, links, pages of drivers, no name of a system."""

import ast
import re
import tokenize
import tomllib
from pathlib import Path
from runpy import run_path

import pytest
from tree import PRODUCT, TOP, files_that_say, name_of, nodes_of, python_files, text_files, text_of, tree_of

from bench.model.drivers import manual_of
from bench.model.systems import analyses

PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))
LOCKS = sorted((TOP / "requirements").glob("*.txt"))
SHIPPED = ("frames", "sequences", "stations")
TRACES = re.compile(
    r"(?<![\w.])/(?:root|work|opt|home/[a-z]+|Users/[A-Za-z]+)/[\w.]"
    r"|(?:pypi|index|artifact\w*)\.[a-z]+(?:\.[a-z]+)*/simple"
    r"|--(?:extra-)?index-url[ =]\S"
)


def test_every_package_is_in_the_wheel() -> None:
    found = {".".join(path.parent.relative_to(TOP).parts) for path in python_files(*PRODUCT) if path.parent != TOP}
    setuptools = PROJECT["tool"]["setuptools"]
    assert set(setuptools["packages"]) == found | {f"bench.shipped.{kind}" for kind in (*SHIPPED, "docs")}
    for kind in SHIPPED:
        assert setuptools["package-dir"][f"bench.shipped.{kind}"] == kind
        assert setuptools["package-data"][f"bench.shipped.{kind}"] == ["*.yaml"]
        assert list((TOP / kind).glob("*.yaml"))


def test_files_beside_the_code_go_into_the_wheel() -> None:
    patterns = PROJECT["tool"]["setuptools"]["package-data"]
    for path in (TOP / "bench").rglob("*"):
        if path.is_file() and path.suffix not in {".py", ".pyc"}:
            owners = [name for name in patterns if (TOP / name.replace(".", "/")) in path.parents]
            matched = [path.match(f"{owner.replace('.', '/')}/{glob}") for owner in owners for glob in patterns[owner]]
            assert any(matched), name_of(path)


def test_locks_are_hashed_name_no_index_and_agree() -> None:
    for path in LOCKS:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        text = "".join(line for line in lines if not line.lstrip().startswith("#"))
        assert not re.search(r"index-url|find-links|trusted-host|file:|https?:", text), path
        pinned = re.findall(r"^[a-z0-9][a-z0-9._-]*==\S+ \\\n    --hash=sha256:[0-9a-f]{64}", text, re.MULTILINE)
        assert len(pinned) == len(re.findall(r"^[^#\s-]", text, re.MULTILINE)) > 0, path
    pins = {path.stem: dict(re.findall(r"^(\S+)==(\S+)", path.read_text("utf-8"), re.MULTILINE)) for path in LOCKS}
    assert set(pins) == {"benchmark", "broker", "build", "dev", "docs", "mutation", "run"}
    for other in ("dev", "docs", "benchmark", "mutation"):
        assert pins["run"].items() <= pins[other].items()


def test_no_trace_of_one_machine() -> None:
    own = Path(__file__)
    found = [
        f"{name_of(path)}: {match[0]}"
        for path in text_files()
        if path != own
        for match in TRACES.finditer(path.read_text(encoding="utf-8", errors="replace"))
    ]
    assert found == []


FRAMES = sorted((TOP / "frames").glob("*.yaml"))


def is_driver(path: Path) -> bool:
    """Return whether a module names its driver class."""
    return re.search(r"^DRIVER = ", text_of(path), re.MULTILINE) is not None


DRIVERS = [path for path in python_files("instruments") if path.parent.name == "instruments" and is_driver(path)]


def test_driver_has_simulator_and_protocol_test() -> None:
    assert [path.name for path in DRIVERS if not (TOP / "sim_instruments" / path.name).is_file()] == []
    rows = "".join(text_of(path) for path in (TOP / "tests" / "protocol").glob("test_*.py"))
    assert [path.stem for path in DRIVERS if f'NAME = "{path.stem}"' not in rows] == []


def test_frame_has_a_golden() -> None:
    without = [path for path in FRAMES for word in ("golden", "expect") if not re.search(rf"\b{word}:", text_of(path))]
    assert without == []


def test_simulated_truth_is_out_of_reach() -> None:
    rooms = ("maths", "replay", "report", "analysis", "session", "systems", "record", "store")
    for path in files_that_say("truth", *(f"bench/{room}" for room in rooms)):
        strings = {node.value for node in nodes_of(path) if isinstance(node, ast.Constant)}
        assert not any(isinstance(text, str) and "truth.json" in text for text in strings), name_of(path)


def test_every_mutant_finds_its_text_and_its_tests() -> None:
    wrong = []
    for mutant in run_path(str(TOP / "tests" / "mutants" / "catalogue.py"))["MUTANTS"]:
        wrong += [mutant.name] if text_of(TOP / mutant.file).count(mutant.old) != 1 else []
        named = (test.partition("[")[0].split("::") for test in mutant.tests)
        wrong += [f"{file}::{name}" for file, *_, name in named if f"def {name}(" not in text_of(TOP / file)]
    assert wrong == []


LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
PAGES = [TOP / "README.md", TOP / "CHANGELOG.md", *sorted((TOP / "docs").rglob("*.md"))]
MATRIX = TOP / "tests" / "fault" / "matrix.md"
TEST = re.compile(r"`(tests/[a-z_0-9/]+\.py)::(test_\w+)`")
ROWS = 30
RECORD = TOP / "tests" / "validation.md"
_ROW = re.compile(
    r"^\| (?P<what>[^|]+) \| (?P<against>[^|]+) \| (?P<figure>[^|]+) \| `(?P<test>[^`]+)` \|$", re.MULTILINE
)


def test_links_lead_somewhere() -> None:
    broken = [
        f"{name_of(page)}: {target}"
        for page in PAGES
        for target in LINK.findall(page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert broken == []


def fault_rows() -> dict[int, list[str]]:
    found = {}
    for line in text_of(MATRIX).splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("|") and cells[0].isdigit():
            found[int(cells[0])] = cells
    return found


def marks(path: str, name: str) -> set[str]:
    """Return the marks on a test function itself; parameters may have marks of their own."""
    for node in tree_of(TOP / path).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return {ast.unparse(mark).removeprefix("pytest.mark.").split("(")[0] for mark in node.decorator_list}
    raise AssertionError(f"{path} has no test {name}")


def test_each_row_names_its_tests_and_its_target() -> None:
    rows = fault_rows()
    assert sorted(rows) == list(range(1, ROWS + 1))
    for number, (*_, in_ci, in_sweep, target) in rows.items():
        named = TEST.findall(in_ci)
        assert named, number
        assert not [name for path, name in named if "sweep" in marks(path, name)]
        for path, name in TEST.findall(in_sweep):
            marks(path, name)
        assert bool(in_sweep) == bool(target), number
        assert not target or f"\n{target.strip('`')}:" in text_of(TOP / "Makefile"), number


def marked() -> dict[str, tuple[str, str]]:
    """Return the marked tests by path and name -> (what, against)."""
    found: dict[str, tuple[str, str]] = {}
    for path in files_that_say(r"pytest\.mark\.validates", "tests"):
        for node in ast.walk(tree_of(path)):
            for mark in getattr(node, "decorator_list", ()):
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.validates":
                    assert isinstance(node, ast.FunctionDef)
                    against = next(ast.literal_eval(word.value) for word in mark.keywords if word.arg == "against")
                    found[f"{name_of(path)}::{node.name}"] = (ast.literal_eval(mark.args[0]), against)
    return found


def recorded() -> dict[str, re.Match[str]]:
    return {row["test"]: row for row in _ROW.finditer(RECORD.read_text(encoding="utf-8"))}


def test_the_record_lists_the_marked_tests() -> None:
    listed = {test: (row["what"], row["against"]) for test, row in recorded().items()}
    assert listed == marked(), "run 'make validate'"


def test_nothing_in_the_record_has_failed_and_every_row_is_a_comparison() -> None:
    rows = recorded()
    assert len(rows) >= 70
    assert [test for test, row in rows.items() if "FAILED" in row["figure"]] == []
    assert [test for test, row in rows.items() if len(row["against"]) < 10] == []


ROOMS = sorted(
    f"bench/{path.name}"
    for path in (TOP / "bench").iterdir()
    if (path / "__init__.py").exists() and path.name != "systems"
)
WORDS = "af_converter|ngu|gnc|gnc_module|imu|fog|fog_north|north_finder|rlg|lock_in|ring_laser|time_sync|egi|sar"
NAMED = re.compile(rf"(?<![A-Za-z0-9])(?:{WORDS})(?![A-Za-z0-9])", re.IGNORECASE)


def words_of(path: Path) -> list[str]:
    """Return identifiers and strings of a file that say a word of a system, with their lines; comments do not count."""
    with path.open("rb") as stream:
        tokens = [
            token for token in tokenize.tokenize(stream.readline) if token.type in (tokenize.NAME, tokenize.STRING)
        ]
    hits = [(token.start[0], NAMED.search(token.string)) for token in tokens]
    return [f"{name_of(path)}:{line} {hit[0]}" for line, hit in hits if hit is not None]


def test_no_room_of_the_engine_names_a_system() -> None:
    assert len(ROOMS) > 10
    assert [word for path in files_that_say(NAMED.pattern, *ROOMS) for word in words_of(path)] == []


WORDS_OF_THE_LANGUAGE = {"readings"}  # of a record; an analysis of all readings has the same name


def test_no_room_of_the_engine_asks_for_an_analysis_by_its_name() -> None:
    known = analyses().keys() - WORDS_OF_THE_LANGUAGE
    strings = [
        (name_of(path), node.value)
        for path in files_that_say("|".join(map(re.escape, known)), *ROOMS)
        for node in nodes_of(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    assert [place for place in strings if place[1] in known] == []


def test_a_word_in_a_name_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("test_shipping.name_of", lambda path: path.name)
    path = tmp_path / "sample.py"
    path.write_text("limits_of_gnc = {'fog_north': 1}\nsarcasm = 'longitude'\n")
    assert words_of(path) == ["sample.py:1 gnc", "sample.py:1 fog"]


MANUALS = sorted(path.stem for path in (TOP / "instruments").glob("*.yaml"))


def test_every_driver_has_a_table_that_makes_sense() -> None:
    assert sorted(path.stem for path in DRIVERS) == MANUALS
    for driver in MANUALS:
        manual = manual_of(driver)
        assert manual is not None
        for form, command in manual.commands.items():
            re.compile(command.reply)
            assert not command.example or manual.find(command.example) == form
            assert "?" not in form or (command.reply and command.touch == "asks"), form
