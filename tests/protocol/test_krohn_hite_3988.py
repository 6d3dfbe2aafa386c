"""Exact exchanges of the band-pass filter."""

from __future__ import annotations

from typing import Any

import pytest
from known_drivers import IDENTIFY
from scripted import refused, scripted

from instruments.krohn_hite_3988 import Display, read_display

START = IDENTIFY["krohn_hite_3988"]


def both(high: bytes, low: bytes, shown: tuple[bytes, bytes]) -> list[tuple[Any, Any]]:
    """Both channels set, then read back."""
    return [
        (b"CH 1;IG 0;OG 0;DC\n", None), (b"CH 1;" + high + b"\n", None),
        (b"CH 2;IG 0;OG 0;DC\n", None), (b"CH 2;" + low + b"\n", None),
        (b"CH 1\n", shown[0]), (b"CH 2\n", shown[1]),
    ]  # fmt: skip


BAND = both(b"HP;BU;F 5.0E-01", b"LP;BU;F 2.0E+00", (b"00 .5000E+0 01.1 00 DC \n", b"00 2.000E+0 02.1 00 DC \n"))
THROUGH = both(b"BY", b"BY", (b"00 byP      01.1 00 DC \n", b"00 byP      02.1 00 DC*\n"))


def test_a_band_of_two_octaves_and_by_pass() -> None:
    with scripted("krohn_hite_3988", [*START, *BAND, *THROUGH]) as band_pass:
        assert band_pass.identify().firmware == "V3.5"
        band_pass.configure(1.0)
        assert band_pass.wanted == (0.5, 2.0)
        band_pass.bypass()
        assert band_pass.wanted == (None, None)


def test_every_line_fits_into_its_buffer() -> None:
    assert max(len(command) for command, _ in BAND) <= 32


@pytest.mark.parametrize(
    ("shown", "why"),
    [
        (b"00 .6000E+0 01.1 00 DC \n", "cutoff"), (b"10 .5000E+0 01.1 00 DC \n", "gain"),
        (b"00 .5000E+0 01.1 06 DC \n", "gain"), (b"00 .5000E+0 01.1 00 AC \n", "coupling"),
        (b"00 .5000E+0 02.1 00 DC \n", "channel"), (b"00 byP      01.1 00 DC \n", "by-pass"),
        (b"00 .5000E+3 01.1 00 DC \n", "kilo"),
    ],
)  # fmt: skip
def test_a_channel_that_reads_back_different_is_noticed(shown: bytes, why: str) -> None:
    script = [*START, *BAND[:4], (b"CH 1\n", shown)]
    with scripted("krohn_hite_3988", script) as band_pass, refused("B-INST-011", "channel 1"):
        band_pass.configure(1.0)
    assert band_pass.wanted is None


def test_a_display_of_another_form_is_not_understood() -> None:
    for reply in ("", "00", "KROHN-HITE V3.5", "00 .5000E+0 01.1 00", "0000"):
        with pytest.raises(ValueError, match="due"):
            read_display(reply)
    assert read_display("20 1.234E+6 02.1 06 AC*") == Display(2, 1.234e6, 20, 6, "AC")
