"""A station may say why nobody arms its bench after a hold."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_sample import make_bench, mistakes

from bench.plan import compile_sequence

PLACE = "simulated: true\n"


def test_a_reason_is_taken(tmp_path: Path) -> None:
    path = make_bench(tmp_path, station=(PLACE, f"{PLACE}arm_after_hold: {{never: locked enclosure}}\n"))
    assert compile_sequence(path).station.never_armed == "locked enclosure"
    assert compile_sequence(make_bench(tmp_path)).station.never_armed == ""


@pytest.mark.parametrize("text", ["{never: }", '{never: ""}', "no", "{}", "{always: x}"])
def test_without_a_reason_it_is_refused(tmp_path: Path, text: str) -> None:
    found = mistakes(make_bench(tmp_path, station=(PLACE, f"{PLACE}arm_after_hold: {text}\n")))
    assert found
    assert all("af_bench_sim.yaml:5:" in error.where for error in found)
