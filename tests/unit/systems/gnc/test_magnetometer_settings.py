"""What the magnetometer's campaign has found is given to the next one, and sent to the module as it was found."""

from __future__ import annotations

import struct

import pytest

from bench.plan import PlannedCommand, compile_sequence


@pytest.mark.parametrize(
    ("settings", "sent"),
    [
        ({}, (0, 0, 0, 10_000, 0)),
        ({"gain": "1"}, (0, 0, 0, 10_000, 0)),
        ({"gain": "1.013"}, (0, 0, 0, 10_130, 0)),
        ({"sin_alpha": "-0.0262"}, (0, 0, 0, 10_000, -2620)),
        ({"offset": "0.012 gauss,-0.024 gauss,0.0024 gauss", "gain": "0.98"}, (100, -200, 20, 9800, 0)),
    ],
)
def test_gain_offset_and_angle_need_not_be_whole_numbers(settings: dict[str, str], sent: tuple[int, ...]) -> None:
    plan = compile_sequence("gnc_magnetometer", None, settings)
    (command,) = [step for step in plan.steps if isinstance(step, PlannedCommand) and step.name == "set_magnetometer"]
    assert struct.unpack("<5h", bytes(command.payload)) == sent
