"""Converter constants, as a scale-factor analysis reads them from the manifest of a session."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.readings import Converter

PLAUSIBLE_ERROR = 0.05  # of the nominal scale factor, where the sequence states nothing


_Positive = Annotated[float, Field(gt=0)]
_NotNegative = Annotated[float, Field(ge=0)]


class _Tolerant(BaseModel):
    """Manifest sections may hold more than one analysis reads."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class Noise(_Tolerant):
    """Declared noise of a converter; without it no uncertainty would be true, so there is no default."""

    white_A_rtHz: _NotNegative
    walk_A_rth: _NotNegative


class Typical(_Tolerant):
    """What the data sheet says of the bias of a channel; predictions of a bias ramp hold for such a one."""

    bias_A: float
    bias_tc1_A_degC: float
    hysteresis_width_A: float
    play_half_width_degC: _Positive


class Channel(_Tolerant):
    """One converter channel of the unit under test."""

    number: Annotated[int, Field(ge=1)]
    kind: str
    k0_C: _Positive
    full_scale_A: _Positive
    sensor_full_scale: _Positive
    sensor_unit: str
    noise: Noise
    levels_A: tuple[float, ...] = ()
    stability_limit_ppm: float | None = None
    bias_stability_limit_A: float | None = None
    plausible_error: _Positive = PLAUSIBLE_ERROR
    typical: Typical | None = None


class Campaign(_Tolerant):
    """Constants of the campaign.

    ``previous``: estimates of an earlier calibration in contract form; ``temperature_sensor_u95_degC``: expanded
    uncertainty (95 %, k = 2) of the unit's own temperature sensor, None if not stated; ``gradient_degC``: how far the
    converters of one of several units in a chamber may be from what its sensor says (95 %, k = 2), None if it is alone;
    ``thermal_lag_s``: typical lag of the unit behind the air, None if not stated; ``master_curve_ppm``: typical
    coefficients of the master oscillator from ppm/degC on.
    """

    analysis: str
    reference_temperature_degC: float = 20.0
    af_clock_Hz: _Positive
    fg_Hz: _Positive = 1e7
    master_Hz: _Positive
    uut: Mapping[str, Any] = Field(default_factory=dict)
    channels: tuple[Channel, ...]
    temperature_sensor_u95_degC: _NotNegative | None = None
    gradient_degC: _NotNegative | None = None
    thermal_lag_s: _Positive | None = None
    master_curve_ppm: tuple[float, float, float] | None = None
    previous: tuple[Mapping[str, Any], ...] = ()

    def channel(self, number: int) -> Channel:
        """Constants of one channel. Raises FitError B-FIT-008 for a channel the campaign does not declare."""
        for channel in self.channels:
            if channel.number == number:
                return channel
        raise FitError(
            "B-FIT-008",
            f"the session has records of channel {number}, but the campaign declares no such channel",
            next_step="add the channel to the campaign's sequence file",
        )

    def converter(self, number: int) -> Converter:
        """Declared constants of one channel in the form the fit takes."""
        channel = self.channel(number)
        return Converter(channel.k0_C, self.af_clock_Hz, channel.noise.white_A_rtHz, channel.noise.walk_A_rth)

    @property
    def sensor_std_degC(self) -> float:
        """Standard uncertainty of the unit's temperature sensor; 0 if not stated."""
        return (self.temperature_sensor_u95_degC or 0.0) / 2.0

    @property
    def gradient_std_degC(self) -> float:
        """Standard uncertainty by the chamber's gradient and the heat of neighbours; 0 for a unit that is alone."""
        return (self.gradient_degC or 0.0) / 2.0

    @property
    def thermal_std_degC(self) -> float:
        """Standard uncertainty of the temperature that a result holds at: sensor and gradient, the same in all rows."""
        return math.hypot(self.sensor_std_degC, self.gradient_std_degC)


def read_campaign(campaign: Mapping[str, Any]) -> Campaign:
    """Check the campaign section of a manifest. Raises FitError B-FIT-008 naming the first wrong field."""
    try:
        return Campaign.model_validate(campaign)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise FitError(
            "B-FIT-008",
            f"the campaign constants are not usable: {first['msg']}",
            where="manifest: campaign." + ".".join(str(part) for part in first["loc"]),
            next_step="check the campaign section of the sequence the session was made with",
        ) from error
