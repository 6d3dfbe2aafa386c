"""Platinum as it is: resistance by the form of Callendar and Van Dusen, with the heat of the measuring current.

The form with alpha, delta and beta is theirs; the analysis uses the later one with A, B and C, so that a mistake in
either does not cancel.

Source: Callendar 1887 and Van Dusen 1925, as in Preston-Thomas, Metrologia 27 (1990), 3, section on the history.
"""

from __future__ import annotations

from dataclasses import dataclass

ALPHA, DELTA, BETA = 3.85055e-3, 1.4997857448935865, 0.10863383153056058  # of industrial platinum
MEASURING_CURRENT_A = 1e-3  # of both instruments on their range of 1 kohm
HEATING_DEGC_W = 50.0  # of an element in the chamber's air: 0.05 degC per milliwatt


@dataclass(frozen=True)
class Element:
    """One platinum element: resistance at 0 degC, mean coefficient, curvature."""

    r0_ohm: float
    alpha: float = ALPHA
    delta: float = DELTA

    def ohm(self, t_degC: float) -> float:
        """Return the resistance of the element at its own temperature."""
        hundredth = t_degC / 100.0
        bent = self.delta * hundredth * (hundredth - 1.0)
        if t_degC < 0.0:
            bent += BETA * (hundredth - 1.0) * hundredth**3
        return self.r0_ohm * (1.0 + self.alpha * (t_degC - bent))

    def heated_ohm(self, t_degC: float) -> float:
        """Return the resistance while it is measured: the current heats the element above what surrounds it."""
        power_W = MEASURING_CURRENT_A**2 * self.ohm(t_degC)
        return self.ohm(t_degC + HEATING_DEGC_W * power_W)
