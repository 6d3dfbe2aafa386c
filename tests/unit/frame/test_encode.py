"""The encoder refuses what does not fit; it never wraps and never clips."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from record_sample import frame

from bench.model.errors import InputError

GOOD: dict[str, Any] = {
    "counter": 1, "npp": 2, "ppp": 3, "af_clock": 4, "master_count": 5, "fg_count": 6, "status": 0,
}  # fmt: skip


def refused(columns: dict[str, Any], port: str = "a", message: str = "frame") -> str:
    with pytest.raises(InputError) as caught:
        frame(f"ngu_{port}").encode(columns, 4, message)
    return caught.value.code


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"af_clock": 1 << 24}, "B-FRAME-021"),
        ({"counter": -1}, "B-FRAME-021"),
        ({"npp": np.full((4, 10), 65536)}, "B-FRAME-021"),
        ({"npp": np.full((4, 10), 0.5)}, "B-FRAME-021"),
        ({"status.mode": 16}, "B-FRAME-022"),
        ({"nothing": 1}, "B-FRAME-022"),
        ({"npp": np.zeros((4, 9), int)}, "B-FRAME-020"),
        ({"counter": np.zeros(3, int)}, "B-FRAME-020"),
    ],
)
def test_wrong_columns(change: dict[str, Any], code: str) -> None:
    columns = GOOD | change
    if "status.mode" in change:
        del columns["status"]
        columns["status.mode"] = 16
        assert refused(columns) == "B-FRAME-021"
    else:
        assert refused(columns) == code


def test_missing_column_and_unknown_message() -> None:
    assert refused({name: value for name, value in GOOD.items() if name != "ppp"}) == "B-FRAME-020"
    assert refused(GOOD, message="housekeeping") == "B-FRAME-023"
    assert refused({"command": 1, "payload": b""}, "b", "command") == "B-FRAME-020"
    with pytest.raises(InputError, match="B-FRAME-020"):
        frame("ngu_b").encode_one({"command": 1}, "command")


def test_a_frame_longer_than_the_limit_is_refused() -> None:
    frame("ngu_b").encode_one({"command": 1, "payload": bytes(248)}, "command")
    with pytest.raises(InputError, match="B-FRAME-021"):
        frame("ngu_b").encode_one({"command": 1, "payload": bytes(249)}, "command")


def test_named_bits_make_the_whole_field() -> None:
    columns = {name: value for name, value in GOOD.items() if name != "status"}
    rows = frame("ngu_a").encode(columns | {"status.mode": np.array([0, 1, 2, 15]), "status.over_range": 513}, 4)
    assert rows[:, 53].tolist() == [0x04, 0x14, 0x24, 0xF4]
    assert rows[:, 54].tolist() == [0x02] * 4


def test_broadcast_values_and_whole_floats() -> None:
    rows = frame("ngu_a").encode(GOOD | {"counter": np.array([1.0, 2.0, 3.0, 65535.0]), "npp": np.arange(10)}, 4)
    batch = frame("ngu_a").decoder().feed(rows.tobytes()).messages["frame"]
    assert batch.raw("counter").tolist() == [1, 2, 3, 65535]
    assert batch.raw("npp").tolist() == [list(range(10))] * 4


def test_asking_a_batch_for_an_unknown_field() -> None:
    batch = frame("ngu_a").decoder().feed(b"").messages["frame"]
    for name in ("np", "status.model", "counter.x"):
        with pytest.raises(InputError, match="B-FRAME-022"):
            batch.raw(name)
