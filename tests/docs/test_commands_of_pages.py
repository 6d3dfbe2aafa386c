"""Every block of the pages is run, checked in place of a long run, held against its schema, or at least parsed."""

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
import tomllib
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer
from commands_not_run import MOST_CHECKED, MOST_PARSED, NOT_RUN
from doc_blocks import PAGES, ROOT, Block, blocks, blocks_of, words_of
from jsonschema import Draft202012Validator
from pydantic import RootModel
from rehearsal import Inside, writable_copy

from bench.cli import app
from bench.model.drivers import Manual
from bench.model.yamlio import parse_yaml
from bench.plan import json_schemas, mapping_schema

GOLDEN = ROOT / "tests" / "golden" / "sessions"
TUTORIAL = "docs/tutorial.md"  # is executed by a shell
BLOCKS = [block for block in blocks("sh") if block.page != TUTORIAL]
QUICK = {"first_check"}
CHECKED: list[list[str]] = []  # of which plans are not checked again for each page
SESSION_OF = {
    "docs/method-north.md": "20000101T000002Z_golden_fog_GOLDEN",
    "docs/method-gnc.md": "20000101T000002Z_gnc_unit_test_GOLDEN",
    "docs/method-ring-laser.md": "20000101T000000Z_golden_rlg_GOLDEN",
}
EXAMPLES = {  # what stands for the things of the reader
    "MAKE_UP_SESSION": "SESSION",
    "sessions/20000101T000000Z_scale_factor_38h_SIM-1": "SESSION",
    "sessions/20000101T000000Z_scale_factor_short_SIM-1": "SESSION",
    "SIM-1": "GOLDEN",
    "--uut GNC-02": "--uut GOLDEN",
    "sequences/my_campaign.yaml": "scale_factor_short",
    "FRAME FILE": "ngu_a capture.bin",
    "CAPTURE": "capture.bin",
    "frames/my_device.yaml": "my_device.yaml",
    "$S/": f"{GOLDEN}/",
}
NOT_OURS = ("ssh ", "dask ", "export ", "rm ", "pip install -e . --no-deps", "cd our_lab", "pytest ")


def reason(line: str) -> str:
    """Return why a command is not run, "" if it is."""
    return next((why for beginning, why in NOT_RUN.items() if line.startswith(beginning)), "")


def of_the_bench(block: Block) -> list[str]:
    """Return the command lines of a block that begin with ``bench``."""
    lines = [line.removeprefix(".venv/bin/") for line in block.command_lines]
    return [line for line in lines if line.startswith("bench ")]


def is_long(line: str) -> bool:
    """Return whether a command runs a campaign that takes more than a second or two: its plan is checked instead."""
    return line.startswith("bench run ") and line.split()[2] not in QUICK


def for_this_test(line: str, session: str) -> list[str]:
    """Return the words of a command line with the things of this test in place of the reader's."""
    for theirs, ours in EXAMPLES.items():
        line = line.replace(theirs, ours)
    words = words_of(re.sub(r"(?<![A-Z_])SESSION\b", session, line))[1:]
    if is_long(line):
        kept = ("--set", "--station")
        pairs = [word for pair in pairwise(words) if pair[0] in kept for word in pair]
        return ["check", words[1], *pairs]
    return [name for word in words for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]


def lab(golden: Path, place: Path) -> Path:
    """Make a folder with what a reader has: a session and its history, a laboratory file, a capture, a log."""
    writable_copy(golden.parent, place / "sessions")
    for name in ("laboratory.yaml", "corrected.yaml"):
        shutil.copy(ROOT / "docs" / name, place)
    frame = bytes.fromhex((ROOT / "tests" / "golden" / "ngu_a.hex").read_text())
    (place / "capture.bin").write_bytes(frame * 20)
    rows = "".join(f"{0.01 * row:.2f},{0.1 * (row % 7):.1f}\n" for row in range(200))
    (place / "log.csv").write_text(f"time [s],gyro x [deg/s]\n{rows}")
    return place


@pytest.mark.parametrize("page", sorted({block.page for block in BLOCKS if of_the_bench(block)}))
def test_the_commands_of_a_page_run(
    page: str, golden: Path, tmp_path: Path, inside: Inside, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run those of a block one behind the other, as a reader does; what is refused has another status than 0 and 1."""
    for block in (block for block in BLOCKS if block.page == page and of_the_bench(block)):
        place = lab(golden, tmp_path / str(block.line))
        monkeypatch.chdir(place)
        monkeypatch.setenv("XDG_CACHE_HOME", str(place))  # what one command computes the next one finds, as there
        session = f"sessions/{SESSION_OF.get(page, golden.name)}"
        if page in SESSION_OF:
            shutil.copytree(GOLDEN / "0.1.0" / SESSION_OF[page], session)
        for line in block.command_lines:
            line = line.removeprefix(".venv/bin/")
            if line.startswith("cd "):
                monkeypatch.chdir(line.split()[1])
            elif line.startswith("bench ") and not reason(line):
                words = for_this_test(line, session)
                if is_long(line) and words in CHECKED:
                    continue
                CHECKED.append(words)
                done = inside(*words)
                assert done.returncode in (0, 1), f"{block.place}: {line}: {done.stderr}"


def test_what_is_not_run_is_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.commands.requests.session_segments", str)  # of no session that is here
    top = typer.main.get_command(app)
    for line in sorted({line for block in BLOCKS for line in of_the_bench(block) if reason(line)}):
        words = words_of(line)[1:]
        context = top.make_context("bench", words)
        name, command, rest = top.resolve_command(context, words)
        command.make_context(name, rest, parent=context)


def test_other_programs_are_known() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    lines = [
        line for block in BLOCKS for line in block.command_lines if line.removeprefix(".venv/bin/")[:6] != "bench "
    ]
    targets = [words_of(line)[1] for line in lines if line.startswith("make ")]
    assert [target for target in targets if f"\n{target}:" not in makefile] == []
    tests = [word for line in lines if line.startswith("pytest ") for word in words_of(line) if word[:6] == "tests/"]
    assert [name for name in tests if not (ROOT / name).exists()] == []
    assert [line for line in lines if not line.startswith(("make ", *NOT_OURS))] == []


def test_few_commands_are_not_run() -> None:
    lines = [line for block in BLOCKS for line in of_the_bench(block)]
    unused = [beginning for beginning in NOT_RUN if not any(line.startswith(beginning) for line in lines)]
    counted = Counter("parsed" if reason(line) else "checked" if is_long(line) else "run" for line in lines)
    print(f"commands of the pages: {dict(counted)}")
    assert unused == []
    assert counted["parsed"] <= MOST_PARSED
    assert counted["checked"] <= MOST_CHECKED


SCHEMAS = {
    **json_schemas(),
    "mapping": mapping_schema(),
    "manual of an instrument": Manual.model_json_schema(),
}
NAMES = {  # what a piece of a module stands in
    "docs/api.md": """
from collections.abc import Callable
from types import SimpleNamespace
import pytest
from bench.analysis import Analysis, Material
from sim_instruments.worlds.common.terminals import Source, Terminals
self = SimpleNamespace(terminals=Terminals())
""",
    "docs/instruments.md": """
from bench.model.ports import Effect, Parameter, action
from instruments.values import exponent_form
""",
    "docs/user-guide.md": """
from bench.model.declaration import AnalysisDeclaration
METHODS = ("mean",)
""",
}
RUN_ELSEWHERE = {
    "docs/api.md": "tests/runs/test_python_api.py",
    "docs/session-format.md": "tests/support/stranger_page.py",
    "docs/tutorial.md": "tests/docs/test_commands_of_pages.py",
}


class AnyDocument(RootModel[Any]):
    """A YAML document of any form, as the loader of the bench reads it."""


def document_of(block: Block) -> dict[str, Any]:
    """Return the document that a block is a part of: a list of steps is one of a sequence."""
    content = parse_yaml(block.text, block.place, AnyDocument).model.root
    return {"steps": content} if isinstance(content, list) else content


def test_yaml_holds_its_schema() -> None:
    """Find the kind of file that has all the keys of a block, and hold each value against the schema of its key."""
    for block in blocks("yaml"):
        document = document_of(block)
        problems = {
            kind: [error.message for error in Draft202012Validator({**schema, "required": []}).iter_errors(document)]
            for kind, schema in SCHEMAS.items()
            if document.keys() <= schema["properties"].keys()
        }
        assert [] in problems.values(), f"{block.place}: {problems or 'no kind of file has these keys'}"


def test_python_runs() -> None:
    for block in blocks("python"):
        if block.page in RUN_ELSEWHERE and (block.page not in NAMES or "bench.load(" in block.text):
            assert Path(block.page).name in (ROOT / RUN_ELSEWHERE[block.page]).read_text(encoding="utf-8")
            continue
        text = NAMES.get(block.page, "") + textwrap.dedent(block.text)
        exec(compile(text, block.place, "exec"), {"__name__": "page"})


def test_toml_is_that_of_the_example() -> None:
    (block,) = blocks("toml")
    shown = tomllib.loads(block.text)["project"]["entry-points"]
    example = ROOT / "examples" / "resistance_thermometer" / "pyproject.toml"
    assert shown.items() <= tomllib.loads(example.read_text(encoding="utf-8"))["project"]["entry-points"].items()


def test_every_block_with_a_language_is_looked_at() -> None:
    """JSON is the manifests of the session format, from which tests/unit/record writes sessions; what is written for
    Prometheus is read by tests/unit/web/telemetry."""
    known = {"sh", "yaml", "python", "toml", "text", "nginx", "prometheus"}
    found = [block for page in PAGES for block in blocks_of(page) if block.language not in known]
    assert {(block.language, block.page) for block in found} == {("json", "docs/session-format.md")}


def test_notebooks_were_executed_in_order_without_an_error() -> None:
    """``make site`` executes them anew and fails with any cell."""
    for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
        assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1)), path
        assert "error" not in {output["output_type"] for cell in cells for output in cell["outputs"]}, path


INSTALL = "pip install "  # needs a package index; .ci/wheel installs the wheel and uses it from an empty folder


def shell_with_bench(folder: Path) -> dict[str, str]:
    """Return an environment in which ``bench`` is this source and ``python`` this interpreter."""
    programs = folder / "programs"
    programs.mkdir()
    for name, words in (("bench", f"{sys.executable} -m bench"), ("python", sys.executable)):
        (programs / name).write_text(f'#!/bin/sh\nexec {words} "$@"\n')
        (programs / name).chmod(0o755)
    return {**os.environ, "PATH": f"{programs}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT), "COLUMNS": "160"}


def plain(text: str) -> str:
    """Return a text with single spaces: how wide a table is drawn does not matter."""
    return " ".join(text.split())


def run(block: Block, place: Path, environment: dict[str, str]) -> tuple[str, Path]:
    """Return what a block of commands says, and the folder in which it leaves the shell."""
    leave = place / ".left"
    done = subprocess.run(
        ["sh", "-euc", f"{block.text}\npwd > {leave}"], cwd=place, env=environment, check=False,
        capture_output=True, text=True, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == 0, f"{block.place}: {said}"
    return said, Path(leave.read_text().strip())


@pytest.mark.slow
def test_the_tutorial_runs_and_prints_what_it_shows(tmp_path: Path) -> None:
    (tmp_path / "inertial-bench").symlink_to(ROOT)
    environment, place, said, compared = shell_with_bench(tmp_path), tmp_path, "", 0
    for block in blocks_of(ROOT / "docs" / "tutorial.md"):
        if block.file:
            (place / block.file).write_text(block.text)
        elif block.language == "sh" and INSTALL not in block.text:
            said, place = run(block, place, environment)
        elif block.language == "text":
            lines = block.text.splitlines()
            assert [line for line in lines if plain(line) not in plain(said)] == [], f"{block.place}: {said}"
            compared += len(lines)
    assert compared >= 10
