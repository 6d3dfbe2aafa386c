"""A radar's image from an imported phase history: where its strongest target stands and how sharp it is.

What the image shows of navigation is in the response: an error of the antenna's positions that is constant moves it,
one that changes along the track widens it and lifts its side lobes (docs/method-time-sync.md).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Estimates,
    Evidence,
    Figure,
    Floats,
    Material,
    Table,
    estimate,
    series,
)
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.image import Complex128, levels_dB
from bench.systems.time_sync.estimators.sar.response import Response, Scene, compressed, scene_of
from bench.systems.time_sync.image import drawn
from bench.systems.time_sync.wording import say

METHODS = ("backprojection",)
_WIDE = 1.2  # of the ideal width
_IN_dB = 20.0 / math.log(10.0)
# Standard deviations per background over peak, by the slopes of sin(pi x) / (pi x): of the -3 dB width and of the place
# of the peak, both in ideal widths.
_WIDTH, _PLACE = 0.335, 0.440


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return place and response of the strongest target, and the image.

    Raises: FitError B-SYNC-010 (no target stands out), B-SYNC-013 (no phase history),
            B-FIT-120 (the antenna does not move), B-FIT-122 (the strongest target is no point).
    """
    samples, positions_m, dropped = _pulses(material)
    sent = material.campaign["frequencies"]
    pulses = compressed(samples, positions_m, float(sent["first_Hz"]), float(sent["last_Hz"]))
    scene = scene_of(pulses, positions_m)
    strongest = scene.responses[0]
    if strongest is None:
        raise FitError(
            "B-FIT-122",
            "the strongest place of the image is no response of a point target: its power does not fall on all sides",
            next_step="look at antenna positions and frequencies of the mapping; a part of the pulses may be sharp",
        )
    return Analysis(
        "radar_image",
        method,
        material.campaign["uut"],
        _estimates(scene, strongest, len(samples), dropped),
        evidence=_evidence(scene, strongest),
        notes=[
            say(
                "note.pulses",
                count=len(samples),
                angle=scene.angle_deg,
                frequencies=samples.shape[1],
                bandwidth=1e-6 * pulses.bandwidth_Hz,
                middle=1e-9 * (sent["first_Hz"] + sent["last_Hz"]) / 2,
            ),
            say("note.unweighted"),
            say("note.intervals"),
        ],
        tables=[_table(scene)],
        figures=[_image(scene), *_cuts(strongest)],
    )


def _pulses(material: Material) -> tuple[Complex128, Floats, int]:
    """Return samples (n, k) and antenna positions (n, 3) of whole pulses, and how many are not."""
    count = sum(name.startswith("in_phase_") for name in material.series)
    parts = [[material.series[f"{part}_{at}"] for at in range(count)] for part in ("in_phase", "quadrature")]
    samples = np.column_stack(parts[0]) + 1j * np.column_stack(parts[1])
    positions_m = np.column_stack([material.series[f"antenna_{axis}"] for axis in "xyz"])
    whole = np.isfinite(samples).all(axis=1) & np.isfinite(positions_m).all(axis=1)
    return samples[whole], positions_m[whole], int(np.count_nonzero(~whole))


def _estimates(scene: Scene, target: Response, n: int, dropped: int) -> Estimates:
    """Return estimates of the strongest target; what adds to it from around scatters them (``_WIDTH``, ``_PLACE``)."""
    counted = {"n": n, "dropped": dropped}
    noise = scene.background / target.peak
    entries = []
    place_m = _place_m(scene, scene.targets_m[0], target)
    for axis, value_m, std_m in zip("xy", place_m, _place_std_m(scene, noise), strict=True):
        entries.append(estimate(f"place_{axis}", "m", value_m, std_m, {}, **counted))
    for cell_m, (axis, cut) in zip(scene.cells_m, target.cuts.items(), strict=True):
        lobe, energy = 10.0 ** (-cut.pslr_dB / 20.0), 10.0 ** (cut.islr_dB / 10.0)
        about = {"axis": axis}
        entries += [
            estimate("resolution", "m", cut.resolution_m, _WIDTH * noise * cell_m, about, **counted),
            estimate("resolution_over_ideal", "1", cut.resolution_m / cell_m, _WIDTH * noise, about, **counted),
            estimate("pslr", "dB", cut.pslr_dB, _IN_dB * noise * math.sqrt((1.0 + lobe**2) / 2.0), about, **counted),
            estimate("islr", "dB", cut.islr_dB, 0.5 * _IN_dB * noise * math.sqrt(2.0 / energy), about, **counted),
        ]
    return entries


def _place_m(scene: Scene, place_m: Floats, target: Response) -> Floats:
    """Return where the image of a target, looked for about ``place_m``, stands on level ground, x and y."""
    out_m = target.range.shift_m / scene.cosine
    return (place_m + target.azimuth.shift_m * scene.axes.azimuth + out_m * scene.axes.sight)[:2]


def _place_std_m(scene: Scene, noise: float) -> Floats:
    along_m, out_m = _PLACE * noise * scene.cells_m[0], _PLACE * noise * scene.cells_m[1] / scene.cosine
    return np.hypot(along_m * scene.axes.azimuth, out_m * scene.axes.sight)[:2]


def _evidence(scene: Scene, target: Response) -> list[Evidence]:
    """Return what says that the place of the target means little: its image is not one of a point in focus."""
    ratio = target.azimuth.resolution_m / scene.cells_m[0]
    if ratio < _WIDE:
        return []
    return [
        Evidence("not_focused", say("evidence.not_focused", ratio=ratio), ratio, 0.0, quantities=("place_x", "place_y"))
    ]


def _table(scene: Scene) -> Table:
    rows: list[list[Any]] = []
    for place_m, response in zip(scene.targets_m, scene.responses, strict=True):
        at_m = place_m[:2] if response is None else _place_m(scene, place_m, response)
        at = [f"{value_m:+.2f}" for value_m in at_m]
        if response is None:
            rows.append([len(rows) + 1, *at, *[say("places.no_point")] * 6])
            continue
        cuts = response.azimuth, response.range
        figures = *(f"{cut.resolution_m:.4f}" for cut in cuts), *(f"{cut.pslr_dB:.2f}" for cut in cuts)
        rows.append([len(rows) + 1, *at, *figures, *(f"{cut.islr_dB:.2f}" for cut in cuts)])
    headers = say.heads(
        "places", "target", "x", "y", "azimuth_width", "range_width", "azimuth_pslr", "range_pslr", "azimuth_islr",
        "range_islr",
    )  # fmt: skip
    caption = say("places.caption", azimuth=scene.cells_m[0], range=scene.cells_m[1])
    return Table(say("image.title"), caption, headers, rows, lead=True)


def _image(scene: Scene) -> Figure:
    parts = [drawn(scene.chip, np.abs(scene.chip.value).max())]
    return Figure(say("image.title"), say("ground.caption"), say("ground.x"), say("ground.y"), parts)


def _cuts(target: Response) -> list[Figure]:
    return [
        Figure(
            say(f"cut.{name}"),
            say("cut.strongest"),
            say(f"cut.{name}.x"),
            say("cut.y"),
            [series(say("places.head.target"), cut.offset_m, levels_dB(cut.value, target.peak), "line")],
            group=say("cut.group"),
        )
        for name, cut in target.cuts.items()
    ]
