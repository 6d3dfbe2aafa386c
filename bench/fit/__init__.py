"""Floor 1: pure estimators, arrays in, result out; no file, clock or logger."""

from bench.fit.bias import Bias, open_input_bias
from bench.fit.clocks import clock_ratio, master_clock_error
from bench.fit.noise import Converter, RangeSpecification, Readings
from bench.fit.scale_factor import METHODS, Referral, ScaleFactor, fit_scale_factor
from bench.fit.temperature import TemperaturePolynomial, fit_temperature
from bench.fit.verdict import coverage_factor, verdict

__all__ = [
    "METHODS",
    "Bias",
    "Converter",
    "RangeSpecification",
    "Readings",
    "Referral",
    "ScaleFactor",
    "TemperaturePolynomial",
    "clock_ratio",
    "coverage_factor",
    "fit_scale_factor",
    "fit_temperature",
    "master_clock_error",
    "open_input_bias",
    "verdict",
]
