"""Colours of the page, read from its stylesheet: nothing too pale, and no two states alike for whoever lacks a cone."""

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

STATIC = Path(bench.web.__file__).parent / "static"
CSS = "".join((STATIC / name).read_text(encoding="utf-8") for name in ("page.css", "panels.css"))
STATES = ("good", "warn", "bad", "live", "idle")
TEXT, GRAPHICS = 4.5, 3.0  # WCAG 2.2, success criteria 1.4.3 and 1.4.11
FAR = 15.0  # CIELAB distance of two colours that mean something else; 2.3 is just noticeable
THEMES = ["dark", "light"]
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
WHITE = XYZ.sum(axis=1)

Vector = NDArray[np.float64]


def linear(colour: str) -> Vector:
    """Linear red, green, blue of #rrggbb. Source: WCAG 2.2, relative luminance."""
    shares = np.array([int(colour[index : index + 2], 16) / 255 for index in (1, 3, 5)])
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours. Source: WCAG 2.2, contrast ratio."""
    dark, bright = sorted(float(XYZ[1] @ linear(colour)) for colour in (one, other))
    return (bright + 0.05) / (dark + 0.05)


def lab(rgb: Vector) -> Vector:
    """CIELAB of linear red, green, blue. Source: ISO/CIE 11664-4."""
    share = XYZ @ np.clip(rgb, 0.0, 1.0) / WHITE
    x, y, z = np.where(share > (6 / 29) ** 3, np.cbrt(share), share * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def nearest(colours: dict[str, str]) -> dict[str, tuple[float, str, str]]:
    """The two colours that are least apart, for each kind of sight."""
    found = {}
    for sight, matrix in SIGHT.items():
        seen = {name: lab(np.array(matrix) @ linear(colour)) for name, colour in colours.items()}
        apart = [(float(np.linalg.norm(seen[a] - seen[b])), a, b) for a, b in itertools.combinations(seen, 2)]
        found[sight] = min(apart)
    return found


def tokens(theme: str) -> dict[str, str]:
    """Colours of a theme by name, as the stylesheet has them."""
    block = CSS.split(':root[data-theme="light"]')[theme == "light"].split("}")[0]
    return dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", block))


def test_contrast_is_that_of_the_recommendation() -> None:
    """Two pairs whose ratio is published with the recommendation: black on white, and #777 on white."""
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)


def test_red_and_green_of_equal_lightness_are_alike_for_some() -> None:
    """The rule can fail: two colours that nearly everybody tells apart, and one in ten men does not."""
    assert [np.sum(matrix, axis=1).round(5).tolist() for matrix in SIGHT.values()] == [[1.0, 1.0, 1.0]] * len(SIGHT)
    found = nearest({"good": "#a8a800", "bad": "#d28e26"})
    assert found["all cones"][0] > FAR
    assert found["deuteranopia"][0] < FAR


@pytest.mark.parametrize("theme", THEMES)
def test_texts_stand_out_and_cards_are_those_of_the_figures(theme: str) -> None:
    colours = tokens(theme)
    assert colours["card"] == figures.PALETTES[theme].card
    for name in ("ink", "soft", "link", *STATES):
        assert min(contrast(colours[name], colours[ground]) for ground in ("card", "ground")) >= TEXT, name
    for state in ("good", "warn", "bad"):
        assert contrast(colours[state], colours[f"{state}-fill"]) >= TEXT, state
    assert contrast(colours["soft"], colours["field"]) >= TEXT
    assert contrast(colours["card"], colours["link"]) >= TEXT  # the main button
    assert min(contrast(colours["edge"], colours[ground]) for ground in ("card", "ground", "field")) >= GRAPHICS


@pytest.mark.parametrize("theme", THEMES)
def test_every_curve_stands_out_from_its_card(theme: str) -> None:
    palette = figures.PALETTES[theme]
    looks = figures.looks()
    assert len({(look["hue"], tuple(look["dash"])) for look in looks}) == len(looks) >= 10
    ratios = {palette.hues[look["hue"]]: contrast(palette.hues[look["hue"]], palette.card) for look in looks}
    assert {hue: ratio for hue, ratio in ratios.items() if ratio < GRAPHICS} == {}
    assert contrast(palette.now, palette.card) >= GRAPHICS
    assert min(contrast(palette.ink, palette.card), contrast(palette.soft, palette.card)) >= TEXT


@pytest.mark.parametrize("theme", THEMES)
def test_states_are_told_apart_whatever_somebody_sees(theme: str) -> None:
    found = nearest({name: tokens(theme)[name] for name in STATES})
    assert {sight: pair for sight, pair in found.items() if pair[0] < FAR} == {}


@pytest.mark.parametrize("where", [*THEMES, "report"])
def test_curves_are_told_apart_whatever_somebody_sees(where: str) -> None:
    hues = REPORT_PALETTE if where == "report" else figures.PALETTES[where].hues
    found = nearest({str(number): hue for number, hue in enumerate(hues)})
    assert {sight: pair for sight, pair in found.items() if pair[0] < FAR} == {}


def test_there_are_four_sizes_of_type() -> None:
    """Each by its name; the mark across a simulated page is a picture, not a text."""
    named = dict(re.findall(r"--(small|text|large|huge): ([\d.]+rem);", CSS.partition("}")[0]))
    assert len(named) == 4
    used = re.findall(r"(?:font-size|font): ?([^;]+);", CSS)
    sizes = {size for size in used if size not in ("inherit", "min(7rem, 9vw)")}
    assert {size for size in sizes if not re.match(r"var\(--(small|text|large|huge)\)", size)} == set()
