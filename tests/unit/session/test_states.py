"""Which records bench recover calls valid: those that the analysis of the session takes, and no others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from planned_step import planned

from bench.model.errors import InputError
from bench.model.quality import Quality
from bench.record.window import UNIT_TEMPERATURE
from bench.session.makeup import make_up_sequence
from bench.session.record_states import record_states
from bench.session.service import merged

SAMPLES = {"samples": True}
COUNTS = {name: np.array([50_000]) for name in ("npp", "ppp", "af_clock", "master_count")}


def row(number: int, temperature_degC: float | None) -> Any:
    conditions = {"channel": 1, "temperature_degC": 23.0}
    window = SimpleNamespace(
        number=number, step=number, link="port_a", frames=50, conditions=conditions,
        t_start_ns=number * 10**9, t_end_ns=number * 10**9 + 5 * 10**8,
    )  # fmt: skip
    context = {} if temperature_degC is None else {UNIT_TEMPERATURE: temperature_degC}
    quality = int(Quality.STALE) if temperature_degC is None else 0
    return SimpleNamespace(window=window, sums=COUNTS, frames=50, lost=0, quality=quality, context=context)


def states(analysis: str) -> list[tuple[str, str]]:
    """Of three records: one measured, one between two that are, one behind the last that is."""
    rows = [row(1, 23.0), row(2, None), row(3, 23.0), row(4, None)]
    steps = [planned("record", number) for number in (1, 2, 3, 4)]
    manifest = {"campaign": {"analysis": analysis}}
    replayed: Any = SimpleNamespace(manifest=manifest, rows=rows, measurement_rows=rows, events=[])
    return [(one.state, one.why) for one in record_states(steps, replayed)]


@pytest.mark.parametrize("analysis", ["scale_factor", "dmm_method"])
def test_a_record_whose_temperature_is_not_known_is_to_be_taken_again(analysis: str) -> None:
    assert states(analysis) == [("valid", "")] * 3 + [("invalid", "without a unit temperature")]


def test_another_analysis_has_other_means() -> None:
    assert states("bias_ramp") == [("valid", "")] * 4


def sampled(number: int, **more: Any) -> Any:
    conditions = {"item": "position"}
    window = SimpleNamespace(number=number, step=number, link="rs422", frames=200, conditions=conditions)
    fields = {"window": window, "sums": {}, "frames": 199, "lost": 1, "quality": 0, "context": {}} | more
    return SimpleNamespace(**fields)


def test_a_record_of_samples_needs_no_clock_counts() -> None:
    """Its frames and flags count; a lost sample is seen from the counter and is no reason to leave the record out."""
    rows = [sampled(1), sampled(2, frames=0, lost=200), sampled(3, quality=int(Quality.OVERLOAD))]
    steps = [planned("record", number, samples=True) for number in (1, 2, 3)]
    manifest = {"campaign": {"analysis": "imu_calibration"}}
    replayed: Any = SimpleNamespace(manifest=manifest, rows=rows, measurement_rows=rows, events=[])
    found = record_states(steps, replayed)
    assert [one.state for one in found] == ["valid", "invalid", "invalid"]
    assert found[1].why == "no frames"
    with pytest.raises(InputError, match="how it was mounted") as caught:
        make_up_sequence(SimpleNamespace(), found)  # type: ignore[arg-type]
    assert caught.value.code == "B-RES-008"


@pytest.mark.parametrize("arguments", [None, {"samples": True}])
def test_what_is_not_made_up_one_by_one_is_not_completed(arguments: dict[str, Any] | None) -> None:
    """Unit tests, which have no records, and records of samples: another session completes neither."""
    step = planned("record", 1, **(arguments or {}))
    view: Any = SimpleNamespace(plan_steps=[] if arguments is None else [step], manifest={"session": "first"})
    with pytest.raises(InputError, match="made up one by one") as caught:
        merged(view, [])
    assert (caught.value.code, caught.value.where) == ("B-RES-010", "first")
