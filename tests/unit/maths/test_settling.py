"""Settling in rooms that never settle: temperatures with 1/f spectra, made by a Fourier transform of their own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from bench.maths.relaxation import _tail, window_of
from bench.model.clock import NS
from bench.run.steps.soak import MOST_CHANCE, Stability

Floats = NDArray[np.float64]
WITHIN_degC, FOR_s, EVERY_s = 0.1, 300, 60
HOURS = 6
ROOMS = 12


def room(rng: np.random.Generator, exponent: float, rms_degC: float) -> Floats:
    """A temperature each second with a spectrum f^-exponent, (n,), degC off the target."""
    n = HOURS * 3600
    f = np.fft.rfftfreq(2 * n)
    f[0] = f[1]
    amplitude = f ** (-exponent / 2.0)
    amplitude[0] = 0.0
    found = np.fft.irfft(amplitude * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size)))[:n]
    return (found - found.mean()) * rms_degC / found.std()


def verdicts(off_degC: Floats) -> tuple[list[bool], list[bool], list[float]]:
    """Of every minute: is it left again within 5 min after "stable" by all samples, by five readings; the chance."""
    ours, readings, chances = [], [], []
    watch, heard = Stability(0.0, WITHIN_degC, float(FOR_s)), 0
    t_ns = np.arange(off_degC.size) * NS
    for now in range(FOR_s, off_degC.size - FOR_s, EVERY_s):
        watch.add(t_ns[heard : now + 1], off_degC[heard : now + 1])
        heard = now + 1
        left = bool((np.abs(off_degC[now + 1 : now + 1 + FOR_s]) > WITHIN_degC).any())
        stable, window = watch.judged(int(t_ns[now]))
        if stable:
            assert window is not None
            assert window.chance is not None
            ours.append(left)
            chances.append(window.chance)
        if (np.abs(off_degC[now - FOR_s : now + 1 : EVERY_s]) <= WITHIN_degC).all():
            readings.append(left)
    return ours, readings, chances


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5])
def test_what_is_called_stable_is_seldom_contradicted(exponent: float) -> None:
    rng = np.random.default_rng(round(10 * exponent))
    ours, readings, chances = [], [], []
    for _ in range(ROOMS):
        found = verdicts(room(rng, exponent, WITHIN_degC * rng.uniform(0.1, 0.8)))
        for all_of, some in zip((ours, readings, chances), found, strict=True):
            all_of += some  # type: ignore[arg-type]
    print(
        f"f^-{exponent:g}: {sum(ours)} of {len(ours)} contradicted, stated {np.mean(chances):.3f}; "
        f"by five readings {sum(readings)} of {len(readings)}"
    )
    assert len(ours) > 100
    assert sum(ours) <= MOST_CHANCE * len(ours)
    assert sum(ours) <= 1.2 * sum(chances) + 3.0
    assert sum(readings) > MOST_CHANCE * len(readings)


@pytest.mark.parametrize("t", [-2.0, 0.0, 0.3, 1.5, 6.0])
def test_the_tail_is_that_of_student(t: float) -> None:
    assert _tail(t, 1.0) == pytest.approx(stats.t.sf(t, 8), abs=1e-12)


def test_a_drift_towards_the_edge_is_not_stable() -> None:
    t_s = np.arange(-300.0, 1.0)
    noise = np.random.default_rng(1).normal(0.0, 0.001, t_s.size)
    calm, drifting = (window_of(t_s, rate * t_s + noise, -0.1, 0.1) for rate in (0.0, 0.00035))
    assert calm.chance == pytest.approx(0.01, abs=1e-3)
    assert drifting.chance is not None
    assert drifting.chance > 0.05  # 0.105 degC further within 300 s, and 0.1 degC of room
    assert drifting.slope_degC_min == pytest.approx(0.021, rel=0.02)


def test_too_few_samples_state_no_chance() -> None:
    window = window_of(np.array([-10.0, -5.0, 0.0]), np.array([0.01, 0.02, 0.03]), -0.1, 0.1)
    assert window.chance is None
    assert window.slope_degC_min == pytest.approx(0.12)
    assert math.isnan(window_of(np.array([0.0]), np.array([0.01]), -0.1, 0.1).slope_degC_min)
