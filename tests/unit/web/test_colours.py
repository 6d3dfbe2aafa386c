"""Colours that no checker of pages sees: curves stand out, and no two states or curves are alike without a cone."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import bench.web
from bench.report.plots.style import PALETTE as REPORT_PALETTE
from bench.web import figures

CSS = (Path(bench.web.__file__).parent / "static" / "page.css").read_text(encoding="utf-8")
GRAPHICS = 3.0  # WCAG 2.2, success criterion 1.4.11
FAR = 15.0  # CIELAB distance of two colours that mean something else; 2.3 is just noticeable
# Linear RGB as seen without one kind of cone. Source: Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph.
# 15(6), 2009, matrices for severity 1.0; each leaves white as it is.
SIGHT = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    "all cones": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
}
# Source: IEC 61966-2-1, sRGB to CIE XYZ, and its white.
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear(colour: str) -> NDArray[np.float64]:
    """Linear red, green, blue of #rrggbb. Source: WCAG 2.2, relative luminance."""
    shares = np.array([int(colour[index : index + 2], 16) / 255 for index in (1, 3, 5)])
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours. Source: WCAG 2.2, contrast ratio."""
    dark, bright = sorted(float(XYZ[1] @ linear(colour)) for colour in (one, other))
    return (bright + 0.05) / (dark + 0.05)


def lab(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIELAB of linear red, green, blue. Source: ISO/CIE 11664-4."""
    share = XYZ @ np.clip(rgb, 0.0, 1.0) / XYZ.sum(axis=1)
    x, y, z = np.where(share > (6 / 29) ** 3, np.cbrt(share), share * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def least_apart(colours: tuple[str, ...]) -> dict[str, float]:
    """How far the two nearest of some colours are apart, for each kind of sight."""
    found = {}
    for sight, matrix in SIGHT.items():
        seen = [lab(np.array(matrix) @ linear(colour)) for colour in colours]
        found[sight] = min(float(np.linalg.norm(one - other)) for one, other in itertools.combinations(seen, 2))
    return found


def states(theme: str) -> tuple[str, ...]:
    """Colours of the states of a run as the stylesheet has them."""
    block = CSS.split(':root[data-theme="light"]')[theme == "light"].split("}")[0]
    return tuple(re.findall(r"--(?:good|warn|bad|live|idle): (#[0-9a-f]{6})", block))


def test_the_rules_can_fail() -> None:
    """Ratios are published with WCAG; red and green of equal lightness are alike for one in ten men."""
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)
    found = least_apart(("#a8a800", "#d28e26"))
    assert (found["all cones"] > FAR, found["deuteranopia"] < FAR) == (True, True)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_curves_stand_out_from_their_card(theme: str) -> None:
    palette = figures.PALETTES[theme]
    assert min(contrast(hue, palette.card) for hue in (*palette.hues, palette.now)) >= GRAPHICS
    assert min(contrast(hue, "#ffffff") for hue in REPORT_PALETTE) >= GRAPHICS
    assert len({(look["hue"], tuple(look["dash"])) for look in figures.looks()}) >= 10


@pytest.mark.parametrize(
    "colours",
    [states("dark"), states("light"), *(palette.hues for palette in figures.PALETTES.values()), REPORT_PALETTE],
)
def test_what_means_something_else_is_told_apart_whatever_somebody_sees(colours: tuple[str, ...]) -> None:
    assert len(colours) >= 5
    assert {sight: apart for sight, apart in least_apart(tuple(colours)).items() if apart < FAR} == {}
