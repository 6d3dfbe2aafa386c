"""Commands that are quick to use are quick to start: what they load; and on how many cores they count."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import pytest
from scipy import special

from bench import cli
from bench.maths.verdict import coverage_factor


def loaded(module: str) -> set[str]:
    """Top-level packages in memory after the import of a module by a fresh interpreter."""
    program = f"import sys, {module}; print(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    return set(done.stdout.split())


@pytest.mark.parametrize("module", ["bench.commands.check", "bench.commands.history.show"])
def test_neither_the_check_nor_the_history_loads_scipy_or_matplotlib(module: str) -> None:
    packages = loaded(module)
    assert "bench" in packages
    assert not packages & {"scipy", "matplotlib"}


def test_the_normal_coverage_factor_is_known_to_the_last_bit() -> None:
    assert coverage_factor() == float(special.ndtri(0.975)) == 1.959963984540054
    assert coverage_factor(math.inf, 0.99) == float(special.ndtri(0.995))
    assert round(coverage_factor(10.0), 2) == 2.23  # JCGM 100:2008 table G.2


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
