"""A capture made by strangers: VN-100 frames between NMEA sentences and text, against their own decode."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from record_sample import captured

from bench.frame import load_frame

ROOT = Path(__file__).resolve().parents[3]
RECORDINGS = Path(os.environ.get("BENCH_REAL_DATA", ROOT.parent / "shared" / "data")) / "vn100"

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not (RECORDINGS / "F00379").exists(), reason=f"no recording {RECORDINGS / 'F00379'}"),
]


@pytest.mark.parametrize("engine", ["numpy", "reference"])
def test_counts_of_the_capture(engine: str) -> None:
    decoded, _ = captured(load_frame(ROOT / "frames" / "vn100_binary.yaml"), RECORDINGS / "F00379", engine)  # type: ignore[arg-type]
    assert (decoded.counts.frames, decoded.counts.bad) == (8895, 2)
    assert decoded.counts.bytes == 1_437_495


@pytest.mark.validates(
    "frame decoder on a real capture of 8,895 frames",
    against="a decode of the same capture by other people's software",
)
def test_all_columns_equal_the_independent_decode_within_its_print_rounding(
    record_property: Callable[[str, object], None],
) -> None:
    _, messages = captured(load_frame(ROOT / "frames" / "vn100_binary.yaml"), RECORDINGS / "F00379")
    batch = messages["frame"]
    names = [item.name for item in batch.message.fields if item.name != "header"]
    ours = np.column_stack([batch.scaled(name) for name in names])
    lines = (RECORDINGS / "F00379_B").read_text(encoding="ascii").splitlines()[1:]
    theirs = np.array([[float(text) for text in line.split(",")[:-1]] for line in lines if line.count(",") == 29])
    assert ours.shape == theirs.shape == (8895, 29)
    # printed as 1.234567e+02: only half a unit of the last printed digit may differ, 5e-5 for values from 100 on
    last_digit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(theirs), 1e-30))) - 6)
    worst = float(np.max(np.abs(ours - theirs) / last_digit))
    record_property("obtained", f"29 columns, worst {worst:.3f} of the last printed digit, limit 0.5")
    assert (np.abs(ours - theirs) <= 0.5 * last_digit * (1 + 1e-6)).all()
