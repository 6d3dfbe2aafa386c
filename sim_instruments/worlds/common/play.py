"""The play (backlash) operator: what a hysteresis remembers of the temperatures it has been through.

A play of half-width r follows a rising input r behind and a falling one r ahead, and rests while the input crosses
2r after a turn. On a stretch without a turn the result depends on the end of the stretch only, so a history is the
list of its turning points and nothing is sampled.

Source: Krasnosel'skii and Pokrovskii, Systems with Hysteresis, section 2 (definition on piecewise monotone inputs).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


def play_after(turns_degC: Sequence[float], half_width_degC: ArrayLike) -> Float:
    """State of the plays after a history that starts relaxed at its first point; half-widths of any shape, degC."""
    half_width = np.asarray(half_width_degC, float)
    state = np.full(half_width.shape, turns_degC[0])
    for degC in turns_degC[1:]:
        state = follow(state, degC, half_width)
    return state


def follow(state_degC: ArrayLike, degC: ArrayLike, half_width_degC: ArrayLike) -> Float:
    """State after the input has gone to ``degC`` without a turn on the way; the arguments broadcast."""
    return np.minimum(np.maximum(state_degC, np.subtract(degC, half_width_degC)), np.add(degC, half_width_degC))
