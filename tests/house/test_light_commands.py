"""A command loads what it needs: a mistyped name costs no numpy, a check no fit, and no analysis but the one named."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys

import pytest
from scipy import special

from bench import cli
from bench.maths.verdict import coverage_factor

LOOK = """
import contextlib, io, json, sys
from bench import cli
sys.argv = ["bench", *sys.argv[1:]]
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    try:
        cli.main()
    except SystemExit as ended:
        status = ended.code
print(json.dumps([int(status), sorted(sys.modules)]))
"""
OF_FITS = {"scipy", "matplotlib", "bokeh", "sqlalchemy", "starlette", "uvicorn", "textual", "jinja2", "GTC"}
OF_FILES = {"numpy", "yaml", "pyvisa", "lz4"}
ROOMS = ("bench.analysis", "bench.session", "bench.report", "bench.run", "bench.store")


def loaded_by(*words: str) -> tuple[int, set[str]]:
    """Exit status of a command, and all modules that it loaded."""
    done = subprocess.run([sys.executable, "-c", LOOK, *words], capture_output=True, text=True, check=True)
    status, modules = json.loads(done.stdout)
    return status, set(modules)


@pytest.mark.parametrize("command", ["run", "replay", "fit", "report"])
def test_a_name_that_is_none_costs_nothing(command: str) -> None:
    status, modules = loaded_by(command, "nosuch")
    assert status == 2
    assert modules & (OF_FITS | OF_FILES) == set()
    assert [name for name in modules if name.startswith((*ROOMS, "bench.systems", "bench.plan"))] == []


def test_the_history_loads_no_fit_and_no_drawing() -> None:
    program = "import sys, bench.commands.history.show; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "bench" in done.stdout.split()
    assert not set(done.stdout.split()) & {"scipy", "matplotlib"}


def test_the_normal_coverage_factor_is_known_without_scipy_to_the_last_bit() -> None:
    assert coverage_factor() == float(special.ndtri(0.975)) == 1.959963984540054
    assert coverage_factor(math.inf, 0.99) == float(special.ndtri(0.995))
    assert round(coverage_factor(10.0), 2) == 2.23  # JCGM 100:2008 table G.2


def test_a_check_loads_declarations_and_no_analysis() -> None:
    status, modules = loaded_by("check", "timeline_example")
    assert status == 0
    assert modules & OF_FITS == set()
    assert "asyncio" not in modules
    systems = {name for name in modules if name.startswith("bench.systems.") and name.count(".") > 2}
    assert {name.rpartition(".")[2] for name in systems} <= {"assumptions", "declaration", "sections"}
    assert [name for name in modules if name.startswith(("bench.analysis.", "bench.report.", "bench.store."))] == []


@pytest.mark.parametrize(("before", "after"), [(None, "1"), ("4", "4")])
def test_one_thread_unless_somebody_wants_more(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], before: str | None, after: str
) -> None:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    for name in names:
        monkeypatch.setenv(name, before or "")
        if before is None:
            monkeypatch.delenv(name)
    monkeypatch.setattr(sys, "argv", ["bench", "version"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    assert capsys.readouterr().out
    assert [os.environ[name] for name in names] == [after, after]
