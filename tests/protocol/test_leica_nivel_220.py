"""Exact telegrams of the inclination sensor."""

from __future__ import annotations

import pytest
from known_drivers import IDENTIFY
from scripted import CLEAR, refused, scripted

START = IDENTIFY["leica_nivel_220"]
QUESTION = b"\x16\x02N1C1 G A\x03\r\n"


@pytest.mark.parametrize(
    ("reply", "expected"),
    [
        (b"\x16\x02C1N1 X:+0.206 Y:-0.040 T:+23.8\x03\r\n", (0.206, -0.04, 23.8)),
        (b"\x16\x02C1N1 X:-1.243 Y:0.587 T: 23.3\x03\r\n", (-1.243, 0.587, 23.3)),
        (b"\x16\x02C1N1 X:+0.206 Y:-0.040 T:+23.8\x03\x02Q\r\n", (0.206, -0.04, 23.8)),  # with a checksum behind ETX
    ],
)
def test_a_measurement(reply: bytes, expected: tuple[float, float, float]) -> None:
    with scripted("leica_nivel_220", [*START, (QUESTION, reply)]) as level:
        found = level.measure()
    assert (found["x_mrad"], found["y_mrad"], found["temperature_degC"]) == expected


def test_who_it_is() -> None:
    with scripted("leica_nivel_220", START) as level:
        assert level.identify().serial == "NIVEL220 632001"
        assert level.drain_errors() == []


@pytest.mark.parametrize(
    "reply",
    [
        b"C1N1 X:+0.206 Y:-0.040 T:+23.8\r\n",  # no frame
        b"\x16\x02C1N2 X:+0.206 Y:-0.040 T:+23.8\x03\r\n",  # another sensor
        b"\x16\x02C1N1 X:+0.206 Y:-0.0 T:\x03\r\n",
        b"\x16\x02C1N1 X:+0.206 T:+23.8\x03\r\n",
        b"\x16\x02C1N1 X:+9.91E37 Y:-0.040 T:+23.8\x03\r\n",
    ],
)
def test_anything_else_is_no_measurement(reply: bytes) -> None:
    again = [(CLEAR, None), (QUESTION, reply)]
    script = [*START, (QUESTION, reply), *again, *again, (CLEAR, None)]
    with scripted("leica_nivel_220", script) as level, refused("B-INST-004"):
        level.measure()
