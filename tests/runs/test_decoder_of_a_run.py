"""A run decodes with the kernel, or says once that it does not; the session is the same."""

from __future__ import annotations

from pathlib import Path

import pytest
from soak_campaign import Quiet, soak_plan, watchers

from bench.frame import best, why_no_kernel
from bench.model.clock import VirtualClock
from bench.run.control.operator import SimulatedOperator
from bench.run.session import Conducted, conduct

SLOW = "there is no kernel today"


def conducted(folder: Path) -> tuple[Conducted, list[str]]:
    """A short campaign, and what was said."""
    folder.mkdir()
    plan, listener = soak_plan(folder), Quiet()
    done = conduct(
        plan, clock=VirtualClock(), seed=5, out=folder / "out", operator=SimulatedOperator(), listener=listener,
        beside=watchers(plan),
    )  # fmt: skip
    assert done.outcome.error is None
    return done, listener.messages


@pytest.mark.skipif(bool(why_no_kernel()), reason=why_no_kernel() or "the kernel is there")
def test_a_session_does_not_depend_on_the_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fast, said = conducted(tmp_path / "kernel")
    assert not any("kernel" in text for text in said)
    monkeypatch.setattr(best, "_loaded", lambda: (None, SLOW))
    slow, said = conducted(tmp_path / "numpy")
    assert said.count(SLOW) == 1
    assert (fast.session_sha256, fast.counts, repr(fast.outcome.rows)) == (
        slow.session_sha256, slow.counts, repr(slow.outcome.rows),
    )  # fmt: skip
