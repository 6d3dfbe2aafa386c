"""What an imported ramp says against its fits: the blocks of a reading are the rows of one search, as in a bias ramp.

Both models are judged by the rows of the joint one, which holds the other but for its up/down term. The noise of a log
is not declared: what is alike for hours scatters, by up to what the fit left over, and a misfit would be taken for it;
so its size is that which fits best, without a departure and with it.
Source: docs/decisions/0006 (joint fit), 0052 (departures).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bench.analysis import Departure, Estimate, Estimates, Floats, Residuals, Searched, search
from bench.systems.af_converter.bias_ramp.departures import Loop
from bench.systems.af_converter.estimators.drift_ramp import (
    BRANCH,
    DRIFT_NAMES,
    TEMPERATURE_NAMES,
    Blocks,
    RampHysteresis,
    drift_design,
    ramp_shape,
    search_bounds,
)
from bench.systems.af_converter.estimators.gates import Drive
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, Gates, HysteresisModel
from bench.systems.af_converter.estimators.hysteresis.search import Problem, first_order
from bench.systems.af_converter.temperature_ramp.fits import RampColumns, ReadingFit, ramp_drive
from bench.systems.af_converter.wording import say

_SMOOTH = 5  # readings of the drive on either side
_AFTER, _TINY = "up_minus_down_after_drift", 1e-9
_LEAST = 1e-60  # of a variance: readings that a model describes exactly leave none
_LAGS, _PLAYS = 6, 8  # beside a drift model, which knows of neither; more of them leave a strong loop doubted oftener
Whiten = Callable[[Floats], Floats]


def searches_of(
    fits: Sequence[ReadingFit], columns: RampColumns, blocks: Blocks, entries: Estimates, reference_degC: float
) -> Iterator[Searched]:
    """Yield the search of every reading; all of them share the chance of a false doubt."""
    drive = ramp_drive(columns, blocks)
    for fit in fits:
        rows = _Rows(fit, columns, blocks, drive, reference_degC)
        residuals, stated = rows.residuals([entry for entry in entries if entry.conditions["reading"] == fit.name])
        yield Searched(search(residuals, rows.departures(), share=1.0 / len(fits)), stated, rows.loop.words)


@dataclass(frozen=True)
class _Rows:
    """The blocks of a reading, (m,)."""

    fit: ReadingFit
    columns: RampColumns
    blocks: Blocks
    drive: Drive
    reference_degC: float

    @property
    def joint(self) -> RampHysteresis | None:
        """The joint fit, where it has a result."""
        return None if self.fit.joint is None or self.fit.joint.fit.beyond else self.fit.joint

    @property
    def _moved(self) -> Floats:
        return self.blocks.mean(self.columns.branch / 2.0)

    @cached_property
    def loop(self) -> Loop:
        """The joint model over the blocks; next to no lag and play where it has no result."""
        gates, bounds = Gates(self.blocks.start_s, self.blocks.end_s), search_bounds(self.blocks, self.drive)
        model = HysteresisModel(gates, self.drive, ramp_shape(self.blocks, self.reference_degC))
        low = bounds.lag_s[0], bounds.half_width_degC[0]
        place = (self.joint.fit.value(LAG), self.joint.fit.value(HALF_WIDTH)) if self.joint else low
        kinds = np.array([say(f"segment.{kind}") for kind in ("hold", "up", "down")])
        branch = kinds[np.round(2.0 * self._moved).astype(np.int64)]
        return Loop(model, gates, place, branch, "reading", self.columns.unit, 1.0, self.fit.name)

    def departures(self) -> list[Departure]:
        """Return all that could be true instead; lags and loops of any kind are none where no joint fit knows one."""
        found = self.loop.departures()
        general = (one for one in found if one.carrier == "reading" and "value" not in one.about)
        return found if self.joint else list(general)

    def residuals(self, entries: Estimates) -> tuple[Residuals, list[Estimate]]:
        """Return the rows for a search, those of the bounds of lag and half-width last, and the estimates of them."""
        noise, t_s = (self.joint or self.fit.drift).noise, self.blocks.middle_s
        free, residual, std = self._free(noise.whitening(t_s).of)
        operators = self._operators(free, noise.whitening(t_s).of, std)
        stated = [entry for entry in entries if entry.quantity in operators and entry.expanded_uncertainty]
        operator = np.array([operators[entry.quantity] for entry in stated])
        alike = np.exp(-np.abs(t_s[:, None] - t_s) / noise.time_s) + _TINY * np.eye(t_s.size)

        def whiten(columns: Floats) -> Floats:
            return np.vstack([columns / np.sqrt(max(noise.white, _LEAST)), np.zeros((std.size, columns.shape[1]))])

        design = whiten(free)
        design[t_s.size :, free.shape[1] - std.size :] = np.diag(1.0 / std)
        expanded = np.array([entry.expanded_uncertainty for entry in stated])
        return (
            Residuals(
                readings=self.fit.readings,
                white=whiten(residual[:, None])[:, 0],
                design=design,
                scatter=whiten(np.sqrt(noise.slow) * np.linalg.cholesky(alike)),
                whiten=whiten,
                operator=operator,
                expanded=expanded,
                noise=expanded,
                noise_dof=float(t_s.size - free.shape[1]),
                shift=lambda effect: operator @ effect,
            ),
            stated,
        )

    def _free(self, whiten: Whiten) -> tuple[Floats, Floats, Floats]:
        """Return columns that nobody knows, (m, p), the residual, (m,), and how far the last columns are known, (q,).

        The noise of a sensor pushes the play to and fro, which the unit's own temperature does not.
        """
        model, drive, (lag_s, half_degC) = self.loop.model, self.drive, self.loop.place
        if not self.joint:
            bounds = search_bounds(self.blocks, drive)
            lags = [model.unit_degC(one) for one in np.geomspace(*bounds.lag_s, _LAGS).tolist()]
            plays = [model.shape_column(lag_s, one) for one in np.geomspace(*bounds.half_width_degC, _PLAYS).tolist()]
            temperature = self.blocks.mean(self.columns.temperature_degC)
            design = drift_design(self.blocks, temperature, self._moved, self.reference_degC)
            return np.column_stack((design, *lags, *plays)), self.fit.drift.residual, np.zeros(0)
        known, residual = first_order(Problem(model, self.fit.readings, whiten), lag_s, half_degC)
        smooth = HysteresisModel(self.loop.gates, replace(drive, degC=_smoothed(drive.degC)), model.shape)
        from_above = HysteresisModel(self.loop.gates, drive, replace(model.shape, play_start=1.0))
        others = [one.shape_column(lag_s, half_degC) for one in (smooth, from_above)]
        return np.column_stack((self._moved, *others, known)), residual, search_bounds(self.blocks, drive).std

    def _operators(self, free: Floats, whiten: Whiten, std: Floats) -> dict[str, Floats]:
        """Return what each quantity gains per unit of a reading, (m,)."""
        drift = dict(zip(self.fit.drift.names, self.fit.drift.operator, strict=True))
        found = {f"{self.fit.name}_tc{order}": drift[name] for order, name in enumerate(TEMPERATURE_NAMES)}
        found |= {name.replace(" ", "_"): drift[name] for name in DRIFT_NAMES} | {_AFTER: drift[BRANCH]}
        if self.joint:
            names = (*self.loop.model.names, LAG, HALF_WIDTH)
            design = np.vstack([whiten(free[:, -len(names) :]), np.eye(len(names))[-2:] / std[:, None]])
            scale = np.linalg.norm(design, axis=0)
            inverse = (np.linalg.pinv(design / scale) / scale[:, None])[:, :-2]
            of_fit = dict(zip(names, inverse @ whiten(np.eye(free.shape[0])), strict=True))
            found |= {
                "hysteresis_width": of_fit[WIDTH],
                "thermal_lag": of_fit[LAG] / 60.0,
                "play_half_width": of_fit[HALF_WIDTH],
            }
        return found


def _smoothed(degC: Floats) -> Floats:
    weights = np.ones(2 * _SMOOTH + 1) / (2 * _SMOOTH + 1)
    return np.convolve(np.pad(degC, _SMOOTH, mode="edge"), weights, mode="valid")
