"""The end of the long flight: targets focused with the navigation solution of every run, and what explains their shift.

Aperture policy: position and velocity updates are held while the radar is on, attitude updates go on. It stands in for
the parametric error modelling of the paper, whose order and weights are not given. The echoes come from where the
antenna truly was; the image knows the navigation solution and the surveyed place of the target alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Floats
from bench.systems.time_sync.estimators.kalman.setup import FineTrack
from bench.systems.time_sync.estimators.sar.image import image_chip
from bench.systems.time_sync.estimators.sar.navigation import positions_at
from bench.systems.time_sync.estimators.sar.pulses import Pulses
from bench.systems.time_sync.estimators.sar.response import Response, SEARCH_m, impulse_response
from bench.systems.time_sync.study.flight import Flown, flight_result, simulated
from bench.systems.time_sync.study.results import Chip, Cut, ImageResult
from bench.systems.time_sync.study.study import TIGHT, APERTURE_s, Group, Task

_CHIP_m = 16.0  # half length: 30 ms at 250 m/s move the target by 8 m
IMAGED = TIGHT  # noise of the filters whose solutions are focused
SHOWN_RUN = 0
_LAG, _BEYOND_LAG_m = 1.2, 8.0  # an image lags by some 9 % more than the offset does, and scatters by 0.8 m


@dataclass(frozen=True)
class Scene:
    """What the radar saw: pulses of one target and of several, and the surveyed places; ``true_m`` (n, 3)."""

    pulse_s: Floats
    true_m: Floats
    one: Pulses
    several: Pulses
    targets_m: Floats

    def search_m(self, offset_s: float) -> tuple[float, float]:
        """Half widths, along track and in range, of the place where a target is looked for: its lag and some more."""
        lag_m = abs(offset_s) * float(np.linalg.norm(self.true_m[-1] - self.true_m[0])) / np.ptp(self.pulse_s)
        return max(SEARCH_m[0], _LAG * lag_m + _BEYOND_LAG_m), SEARCH_m[1]

    @property
    def target_m(self) -> Floats:
        """The target in the middle, (3,)."""
        return np.asarray(self.targets_m[0])


def scene_of(path: Any, opens_s: float) -> Scene:
    """Echoes of an aperture that opens at ``opens_s``, from the true positions of the antenna."""
    sar = simulated("sar_echo")
    radar = sar.Radar(aperture_s=APERTURE_s)
    pulse_s = opens_s + np.arange(round(APERTURE_s * radar.prf_Hz)) / radar.prf_Hz
    true_m, first = path.state(pulse_s).p, path.state(np.array([opens_s]))
    targets_m = sar.scene(radar, first.p[0], first.v[0])
    one, several = (
        _pulses(radar, sar.echoes(radar, true_m, some, np.ones(len(some)))) for some in (targets_m[:1], targets_m)
    )
    return Scene(pulse_s, true_m, one, several, targets_m)


def _pulses(radar: Any, echoes: Any) -> Pulses:
    return Pulses(echoes.gates, echoes.near_range_m, echoes.spacing_m, radar.wavelength_m, radar.bandwidth_Hz)


def image_result(task: Task, flown: Flown) -> ImageResult:
    """Focus the middle target with every run of every group that is imaged."""
    scene = scene_of(flown.path, task.duration_s - APERTURE_s)
    fine = flown.run.fine
    assert fine is not None
    groups = tuple(group for group in task.groups if group.noise == IMAGED)
    found: list[list[tuple[Response, float]]] = []
    several_m, chips = [], []
    for group in groups:
        at = task.groups.index(group)
        search_m = scene.search_m(group.offset_s)
        found.append([_focused(scene, _track(scene, fine, at, run), search_m) for run in range(task.runs)])
        track_m = _track(scene, fine, at, SHOWN_RUN)
        several_m.append([_shift_m(scene.several, track_m, target_m, search_m) for target_m in scene.targets_m])
        chips.append(_chip(scene, track_m, group))
    return ImageResult(
        flight=flight_result(task, flown),
        groups=groups,
        predicted_m=np.array([[predicted_m for _, predicted_m in row] for row in found]),
        several_m=np.array(several_m),
        cuts=tuple(cut for group, row in zip(groups, found, strict=True) for cut in _cuts(group, row[SHOWN_RUN][0])),
        chips=tuple(chips),
        **{name: _figures(found, name) for name in FIGURES},
    )


FIGURES = (
    *("azimuth_shift_m", "range_shift_m", "azimuth_resolution_m", "range_resolution_m"),
    *("pslr_dB", "islr_dB", "peak"),
)


def _figures(found: list[list[tuple[Response, float]]], name: str) -> Floats:
    return np.array([[getattr(response, name) for response, _ in row] for row in found], np.float64)


def _track(scene: Scene, fine: FineTrack, group: int, run: int) -> Floats:
    """Return where navigation says the antenna was at the pulses, (n, 3)."""
    return positions_at(scene.pulse_s, fine.t_s, fine.p[:, group, run], fine.v[:, group, run])


def _focused(scene: Scene, track_m: Floats, search_m: tuple[float, float]) -> tuple[Response, float]:
    response = impulse_response(scene.one, track_m, scene.target_m, search_m)
    return response, predicted_shift_m(scene.pulse_s, track_m, scene.true_m, scene.target_m)


def _shift_m(pulses: Pulses, track_m: Floats, target_m: Floats, search_m: tuple[float, float]) -> float:
    return impulse_response(pulses, track_m, target_m, search_m).azimuth_shift_m


def predicted_shift_m(pulse_s: Floats, track_m: Floats, true_m: Floats, target_m: Floats) -> float:
    """Shift along the track that the errors of a navigation solution explain, m.

    Along-track error in the middle of the aperture, minus range over speed times the error of the velocity along the
    line of sight (from the antenna to the target); both from a straight line through the errors of the positions.
    """
    middle_s = pulse_s.mean()
    slope, middle = np.polyfit(pulse_s - middle_s, track_m - true_m, 1)
    path_m, sight_m = true_m[-1] - true_m[0], target_m - true_m.mean(axis=0)
    speed_m_s = np.linalg.norm(path_m) / (pulse_s[-1] - pulse_s[0])
    along, sight = path_m / np.linalg.norm(path_m), sight_m / np.linalg.norm(sight_m)
    return float(middle @ along - np.linalg.norm(sight_m) / speed_m_s * (slope @ sight))


def _cuts(group: Group, response: Response) -> list[Cut]:
    named = {"azimuth": response.azimuth_cut, "range": response.range_cut}
    shift_m = {"azimuth": response.azimuth_shift_m, "range": response.range_shift_m}
    return [
        Cut(name, group.offset_ms, group.solution, shift_m[name] + cut.offset_m, cut.value)
        for name, cut in named.items()
    ]


def _chip(scene: Scene, track_m: Floats, group: Group) -> Chip:
    chip = image_chip(scene.one, track_m, scene.target_m, half_azimuth_m=_CHIP_m)
    return Chip(group.offset_ms, group.solution, chip.azimuth_m, chip.range_m, np.abs(chip.value))
