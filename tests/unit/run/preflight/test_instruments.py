"""What the pre-flight says about instruments: identities, papers, warmth, reference and the laboratory's air."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from preflight_bench import Instrument, Machine, calls, clock_at_noon, context, no_answer, refuses, served_plan

from bench.model.clock import NS, VirtualClock
from bench.model.ports import Identity
from bench.run.preflight import Finding, Status
from bench.run.preflight.context import PreflightContext
from bench.run.preflight.of_instruments import (
    generators,
    identities,
    laboratory,
    reference,
    self_calibration,
    standards,
    warm_up,
    wiring,
)

DAY_NS = 86_400 * NS


def on_bench(out: Path, role: str, **answers: Any) -> PreflightContext:
    known = Instrument(Identity("maker", "model", "0", "1"), **answers)
    return context(out, instruments={role: known})


def single(findings: list[Finding]) -> Finding:
    (finding,) = findings
    return finding


@pytest.mark.parametrize(
    ("identity", "status", "value"),
    [
        (Identity("FLUKE", "5720A", "SIM5720", "1"), Status.OK, "5720A SIM5720"),
        (Identity("FLUKE", "5720A", "0", "1"), Status.OK, "5720A (tells no number)"),
        (Identity("FLUKE", "5720A", "7", "1"), Status.FAIL, "5720A 7"),
        (None, Status.FAIL, "B-INST-001"),
    ],
)
def test_identity_and_serial_number(tmp_path: Path, identity: Identity | None, status: Status, value: str) -> None:
    bench = context(tmp_path, instruments={"calibrator": Instrument(identity)})
    others = {role: no_answer() for role in bench.station.instruments if role != "calibrator"}
    findings = identities(replace(bench, absent=others))
    assert len(findings) == 10
    assert (findings[0].status, findings[0].value) == (status, value)
    assert all(finding.status is Status.FAIL and finding.of_bench for finding in findings[1:])


def test_identifying_gives_no_second_try(tmp_path: Path) -> None:
    hurried: list[float] = []

    class Quick(Instrument):
        def quick(self, limit_s: float) -> Any:
            hurried.append(limit_s)
            return nullcontext()

    bench = context(tmp_path, instruments={"calibrator": Quick(None)})
    others = {role: no_answer() for role in bench.station.instruments if role != "calibrator"}
    assert identities(replace(bench, absent=others))[0].status is Status.FAIL
    assert hurried == [1.0]


@pytest.mark.parametrize(
    ("days", "status"),
    [(0, Status.OK), (333, Status.OK), (334, Status.WARN), (335, Status.FAIL), (336, Status.FAIL), (-31, Status.FAIL)],
)
def test_certificates_hold_until_the_planned_end(tmp_path: Path, days: int, status: Status) -> None:
    """Calibrated 30 days before the first of March, due 335 days after it; the run takes 3 h, from 22 o'clock."""
    clock = VirtualClock(clock_at_noon().utc_ns() + days * DAY_NS + 10 * 3600 * NS)
    found = standards(context(tmp_path, clock=clock))
    assert found.status is status
    assert ("not valid" in found.value) is (status is Status.FAIL)
    assert not found.of_bench


def test_a_calibrator_that_is_cold_keeps_the_run_from_starting(tmp_path: Path) -> None:
    """The sequence asks for 2 h; that is more than the half hour of the calibrator itself."""
    cold = single(warm_up(on_bench(tmp_path, "calibrator", warm_up_s=1800.0, time_on_s=calls(7100.0))))
    assert (cold.status, cold.value, cold.limit, cold.of_bench) == (Status.FAIL, "1.97 h", "2 h", True)
    warm = single(warm_up(on_bench(tmp_path, "calibrator", warm_up_s=1800.0, time_on_s=calls(7200.0))))
    assert warm.status is Status.OK


def test_a_time_that_is_not_known_is_a_warning_unless_a_prompt_asks(tmp_path: Path) -> None:
    silent = single(warm_up(on_bench(tmp_path, "calibrator", warm_up_s=1800.0, time_on_s=refuses)))
    assert (silent.status, silent.value) == (Status.WARN, "unknown")
    assert "a prompt" in silent.text
    assert single(warm_up(on_bench(tmp_path, "calibrator", warm_up_s=1800.0))).status is Status.SKIPPED
    assert single(warm_up(on_bench(tmp_path, "counter", warm_up_s=1800.0))).status is Status.WARN
    assert warm_up(on_bench(tmp_path, "dmm", warm_up_s=1800.0)) == [], "the plan does not use it"


def test_self_calibration(tmp_path: Path) -> None:
    def found(answer: Any) -> Finding:
        return single(self_calibration(on_bench(tmp_path, "calibrator", self_calibration=answer)))

    assert found(calls((30.0, 30.0, "days", "since"))).status is Status.OK
    late = found(calls((31.0, 30.0, "days", "since")))
    assert (late.status, late.value, late.limit, late.of_bench) == (Status.FAIL, "31 days", "at most 30 days", True)
    assert found(refuses).status is Status.WARN
    assert self_calibration(on_bench(tmp_path, "dmm", self_calibration=refuses)) == []


@pytest.mark.parametrize(
    ("role", "answers", "status"),
    [
        ("counter", [True], Status.OK),
        ("counter", [False, True], Status.WARN),
        ("counter", [False, False], Status.FAIL),
        ("dmm", [False, False], Status.WARN),
    ],
)
def test_the_common_reference(tmp_path: Path, role: str, answers: list[bool], status: Status) -> None:
    found = single(reference(on_bench(tmp_path, role, reference_locked=lambda: answers.pop(0))))
    assert found.status is status
    assert answers == []


def test_a_counter_that_does_not_answer(tmp_path: Path) -> None:
    assert single(reference(on_bench(tmp_path, "counter", reference_locked=refuses))).status is Status.WARN


def test_the_generator_is_left_to_the_campaign(tmp_path: Path) -> None:
    found = single(generators(on_bench(tmp_path, "function_generator", square=None)))
    assert found.status is Status.SKIPPED
    assert "measures it with a counter" in found.text
    steps = tuple(step for step in served_plan().steps if step.name != "measure_frequency")
    bench = on_bench(tmp_path, "function_generator", square=None)
    assert (
        "nothing in the campaign" in single(generators(replace(bench, plan=replace(served_plan(), steps=steps)))).text
    )


@pytest.mark.parametrize(
    ("lab_degC", "status"),
    [(22.0, Status.OK), (24.0, Status.OK), (24.01, Status.FAIL), (21.99, Status.FAIL)],
)
def test_the_laboratory_is_as_the_certificates_want_it(tmp_path: Path, lab_degC: float, status: Status) -> None:
    assert laboratory(on_bench(tmp_path, "logger", scan=calls([lab_degC, 50.0, 50.0]))).status is status


def test_a_laboratory_nobody_measures(tmp_path: Path) -> None:
    assert laboratory(context(tmp_path)).status is Status.WARN
    assert laboratory(on_bench(tmp_path, "logger", scan=refuses)).status is Status.WARN


def test_wiring(tmp_path: Path) -> None:
    found = wiring(context(tmp_path, host=Machine()))
    assert (found.status, found.value) == (Status.OK, "6 records, 3 channels")
    plan = served_plan()
    unwired = replace(plan, steps=tuple(step for step in plan.steps if getattr(step, "purpose", "") != "wiring"))
    assert wiring(context(tmp_path, plan=unwired)).status is Status.WARN
    quiet = replace(unwired, steps=tuple(step for step in unwired.steps if step.name != "operate"))
    assert wiring(context(tmp_path, plan=quiet)).status is Status.SKIPPED
