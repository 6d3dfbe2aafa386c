"""Pulses of a nominal unit in the windows of a plan, against their instants one by one."""

from __future__ import annotations

import numpy as np
import pytest

from bench.model.ports import RecordWindow
from bench.systems.af_converter.nominal import pulses_in

FRAMES = 2000


def window(number: int) -> RecordWindow:
    return RecordWindow(number, "port_a", 500 + number * FRAMES, FRAMES, number * 20 * 10**9, (number + 1) * 20 * 10**9)


def test_many_pulses_take_no_room() -> None:
    """A bias of the wrong unit gives more pulses than fit in any memory; each frame has the same number of them."""
    found = pulses_in(0.25, 5e12, window(0))
    assert found["count"] == 5_000_000_000_000
    assert found["moment1"] == pytest.approx(5e12 * (FRAMES + 1) / 2)
    assert (found["first"], found["at_first"], found["at_last"]) == (500, 2_500_000_000, 2_500_000_000)


@pytest.mark.parametrize("per_window", [0.0, 0.3, 6.4, 51.0, 3500.7])
def test_each_pulse_is_in_its_frame(per_window: float) -> None:
    """The k-th pulse comes when the charge is k quanta; frames are sorted and counted by hand."""
    total, frames_of = 0, []
    for number in range(5):
        begin = 0.25 + number * per_window
        found = pulses_in(begin, per_window, window(number))
        frames = [
            int((k - begin) / per_window * FRAMES) + 1 for k in range(1, 30_000) if begin < k <= begin + per_window
        ]
        frames = [min(frame, FRAMES) for frame in frames]
        assert found["count"] == len(frames)
        assert found["moment1"] == sum(frames)
        assert found["moment2"] == sum(frame**2 for frame in frames)
        if frames:
            first, last = window(number).first_counter + frames[0] - 1, window(number).first_counter + frames[-1] - 1
            assert (found["first"], found["last"]) == (first, last)
            assert (found["at_first"], found["at_last"]) == (frames.count(frames[0]), frames.count(frames[-1]))
        else:
            assert (found["first"], found["last"], found["at_first"], found["at_last"]) == (-1, -1, 0, 0)
        total += found["count"]
        frames_of += frames
    assert total == int(np.floor(0.25 + 5 * per_window)) == len(frames_of)
