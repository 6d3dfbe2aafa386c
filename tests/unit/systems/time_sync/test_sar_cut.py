"""Figures of cuts given in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.cut import Cut, cut_figures, cut_offsets

CELL_m = 0.25


def test_a_hann_weighted_line_has_its_known_figures() -> None:
    """Spectrum weighted by a Hann window: 1.44 bins wide instead of 0.89 (Harris 1978, table 1)."""
    x_m = cut_offsets(CELL_m)
    u = 0.885893 * x_m / CELL_m
    value = np.sinc(u) + 0.5 * np.sinc(u - 1.0) + 0.5 * np.sinc(u + 1.0)
    found = cut_figures(Cut(x_m, value.astype(np.complex128), CELL_m))
    assert found.resolution_m / CELL_m == pytest.approx(1.44 / 0.8859, rel=0.01)
    # the windows stay those of the unweighted response: what the main lobe has outside counts as side lobe
    assert found.pslr_dB == pytest.approx(20.0 * np.log10(0.5), abs=0.1)  # (sinc(0) / 2 at the first zero)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_power_that_falls_on_one_side_only_is_no_response(side: float) -> None:
    x_m = cut_offsets(CELL_m)
    value = np.where(side * x_m > 0.0, np.exp(-np.abs(x_m) / CELL_m), 1.0).astype(np.complex128)
    with pytest.raises(FitError) as caught:
        cut_figures(Cut(x_m, value, CELL_m))
    assert caught.value.code == "B-FIT-122"
