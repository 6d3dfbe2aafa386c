"""Early verdicts: the judge is another process, and whatever becomes of it, the run only listens."""

from __future__ import annotations

import errno
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from run_rig import HoldRig

from bench.analysis import Analysis, Estimate, link_checks
from bench.model.clock import WallClock
from bench.plan.language.sequence import Early
from bench.run.context import RunContext
from bench.run.control.early import EarlyVerdicts, judge_command
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.early import drift_check, repeat_check, residual_check, scatter_check

GOOD = {"ok": True, "records": 3, "checks": []}
BAD = {
    "ok": False, "records": 3,
    "checks": [{"name": "frames lost", "ok": False, "value": 0.5, "limit": 0.001, "text": "half of them"}],
}  # fmt: skip


def early(**changes: Any) -> Early:
    return Early.model_validate({"after": "1 s", "every": "2 s", **changes})


def judged(folder: Path, printing: str, timeout_s: float = 60.0, **changes: Any) -> tuple[HoldRig, RunContext]:
    """A run in which a program is the judge, until its verdict is there."""
    rig = HoldRig(folder, 1)
    context = rig.context()
    context.clock = clock = WallClock()  # type: ignore[assignment]
    context.folder = folder
    verdicts = EarlyVerdicts(early(**changes), context, [sys.executable, "-c", printing], timeout_s)
    verdicts._next_ns = 0  # due now
    for _ in range(2000):
        verdicts.poll()
        if rig.events("verdict"):
            break
        clock.sleep(0.02)
    verdicts.close()
    return rig, context


@pytest.mark.parametrize(
    ("verdict", "on_fail", "held", "code"),
    [
        (BAD, "warn", False, None),
        (BAD, "hold", True, None),
        (BAD, "abort", False, "B-RUN-072"),
        (GOOD, "abort", False, None),  # an event and no more
    ],
)
def test_a_failed_verdict_does_what_the_sequence_declares(
    tmp_path: Path, verdict: dict[str, Any], on_fail: str, held: bool, code: str | None
) -> None:
    rig, context = judged(tmp_path, f"print({json.dumps(json.dumps(verdict))})", on_fail=on_fail)
    assert rig.events("verdict") == [verdict]
    assert bool(context.stop.holds.reasons) == held
    assert (context.stop.fault.code if context.stop.fault else None) == code
    said = any("frames lost 0.5, limit 0.001 (half of them)" in text for text in rig.listener.messages)
    assert said == (verdict is BAD)


@pytest.mark.parametrize(
    ("printing", "words"),
    [
        ("raise SystemExit(7)", "exit status 7"),
        ("import os; os.kill(os.getpid(), 9)", "exit status -9"),
        ("print('{')", "exit status 0"),
        ("print('[1]')", "exit status 0"),
        ("import time; time.sleep(100)", "no verdict in time"),
        ("print('x' * 5_000_000)", "exit status 0"),
    ],
)
def test_a_judge_that_crashes_hangs_or_talks_nonsense_never_touches_the_run(
    tmp_path: Path, printing: str, words: str
) -> None:
    rig, context = judged(tmp_path, printing, 1.0 if "sleep" in printing else 60.0, on_fail="abort")
    assert rig.events("verdict") == [{"ok": None, "error": words}]
    assert context.stop.holds.reasons == {}
    assert context.stop.fault is None


def test_a_judge_that_does_not_start_is_an_event(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = HoldRig(tmp_path, 1)
    verdicts = EarlyVerdicts(early(), rig.context(), ["/nowhere/at/all"])
    rig.clock.sleep(0.9)
    verdicts.poll()
    assert rig.events("verdict") == []  # not due yet
    rig.clock.sleep(0.2)
    verdicts.poll()
    verdicts.poll()
    (event,) = rig.events("verdict")
    assert "does not start" in event["error"]

    def full() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    rig.clock.sleep(2.0)
    verdicts.poll()
    _, event = rig.events("verdict")
    assert "No space left" in event["error"]


def test_the_judge_is_not_imported_by_the_run() -> None:
    words = judge_command(Path("a"), early())
    assert words[1:4] == ["-P", "-m", "bench.session.early"]
    assert json.loads(words[5]) == {"max_lost": 0.001, "max_bad": 0.001, "max_dispersion": 5.0, "max_residual": 6.0}


CAMPAIGN = Campaign.model_validate({
    "analysis": "scale_factor", "af_clock_Hz": 256e3, "master_Hz": 1e7, "uut": {},
    "channels": [{
        "number": 1, "kind": "gyro", "k0_C": 1e-6, "full_scale_A": 0.3, "stability_limit_ppm": 100.0,
        "sensor_full_scale": 80.0, "sensor_unit": "deg/s",
        "noise": {"white_A_rtHz": 1e-6, "walk_A_rth": 0.0},
    }],
})  # fmt: skip


def row(number: int, counts: int, seconds: float = 100.0, **conditions: Any) -> Any:
    frames = round(100 * seconds)
    start_ns = round(number * seconds * 1e9)
    window = SimpleNamespace(
        number=number, conditions={"channel": 1, "current_A": 0.0, **conditions}, first_counter=number * frames,
        frames=frames, t_start_ns=start_ns, t_end_ns=start_ns + round(seconds * 1e9),
    )  # fmt: skip
    sums = {"npp": np.array([counts]), "ppp": np.array([0])}
    return SimpleNamespace(window=window, frames=frames, sums=sums)


def test_links_are_judged_by_their_shares() -> None:
    counts = {"frames": 9_000, "frames_lost": 1_000, "frames_bad": 5}
    lost, bad = link_checks(counts, 0.09, 5e-4)
    assert (lost.ok, lost.value) == (False, 0.1)
    assert (bad.ok, bad.value) == (True, 5e-4)
    assert [check.ok for check in link_checks(dict.fromkeys(counts, 0), 0.1, 0.1)] == [None, None]


def test_a_repeated_point_is_judged_by_noise_pulses_and_stability() -> None:
    """White noise of 1 uA in 1 Hz over 100 s is 0.1 uA; a pulse of 1 uC over 100 s is 4.1 nA; so 0.1415 uA for two."""
    sigma_counts = 0.14154 * 100.0
    for change, ok in ((4.9, True), (5.1, False)):
        rows = [row(1, 1000), row(2, 1000 + round(change * sigma_counts * 1.0))]
        found = repeat_check(rows, CAMPAIGN, 5.0)
        assert found.ok is ok, found
        assert found.value == pytest.approx(change, rel=0.01)
    assert repeat_check([row(1, 1000), row(2, 9000, current_A=1.0)], CAMPAIGN, 5.0).ok is None
    level = [row(1, 10_000_000, current_A=0.1), row(2, 10_000_000 + 2_000, current_A=0.1)]  # 200 ppm of 100 mA
    assert repeat_check(level, CAMPAIGN, 5.0).value == pytest.approx(200.0 / (100.0 / 1.96), rel=0.01)


def test_neighbours_without_a_gap_are_judged_by_their_scatter() -> None:
    rng = np.random.default_rng(4)
    print("seed 4")
    for factor, ok in ((1.0, True), (10.0, False)):
        counts = 1000 + rng.normal(0.0, 10.0 * factor, 200)
        rows = [row(n, round(count), route="open") for n, count in enumerate(counts, 1)]
        found = scatter_check(rows, CAMPAIGN, 5.0)
        assert found.ok is ok
        assert found.value == pytest.approx(factor, rel=0.2)
    assert scatter_check(rows[:5], CAMPAIGN, 5.0).ok is None
    assert scatter_check(rows[::2], CAMPAIGN, 5.0).ok is None  # they do not follow each other


def test_residuals_and_drift_of_a_partial_fit() -> None:
    one = {"number": 3, "channel": 1, "temperature_degC": 20.0, "residual_ppm": -30.0, "std_ppm": 10.0}
    zero = {**one, "residual_ppm": float("nan"), "std_ppm": float("nan")}
    drift = Estimate.model_construct(quantity="dsf_n_drift", value=80.0, std_uncertainty=10.0, unit="ppm")
    analysis = Analysis("scale_factor", "gls", {}, [drift], residuals=[one, zero])
    assert residual_check(analysis, 2.9).ok is False
    assert residual_check(analysis, 3.0).ok is True
    assert drift_check(analysis, 5.0).value == 8.0
    assert drift_check(analysis, 5.0).ok is False
    empty = Analysis("scale_factor", "gls", {}, [])
    assert [residual_check(empty, 1.0).ok, drift_check(empty, 1.0).ok] == [None, None]
