"""Analyses by name: a campaign names its analysis, the registry names the module that does it."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Protocol

from bench.analysis.analysis import Analysis
from bench.analysis.material import Material
from bench.model.errors import FitError
from bench.systems.af_converter.bias_ramp import analysis as bias_ramp
from bench.systems.af_converter.dmm_method import analysis as dmm_method
from bench.systems.af_converter.scale_factor import analysis as scale_factor
from bench.systems.af_converter.temperature_ramp import analysis as temperature_ramp
from bench.systems.gnc.bias import analysis as imu_bias
from bench.systems.gnc.calibration import analysis as imu_calibration
from bench.systems.gnc.logs import (
    multi_position as imu_multi_position,
)
from bench.systems.gnc.logs import (
    six_position as imu_six_position,
)
from bench.systems.gnc.logs import (
    strapdown as imu_strapdown,
)
from bench.systems.gnc.magnetometer import analysis as magnetometer
from bench.systems.gnc.unit_test import analysis as gnc_unit_test
from bench.systems.lock_in import analysis as rlg_lock_in
from bench.systems.north import analysis as fog_north
from bench.systems.time_sync import analysis as time_sync


class AnalysisModule(Protocol):
    """What a module of a system offers to be an analysis."""

    METHODS: tuple[str, ...]

    def analyse(self, material: Material, method: str = ...) -> Analysis:
        """From records and the manifest's constants to estimates."""


ANALYSES: Mapping[str, AnalysisModule] = {
    "scale_factor": scale_factor,
    "bias_ramp": bias_ramp,
    "dmm_method": dmm_method,
    "temperature_ramp": temperature_ramp,
    "gnc_unit_test": gnc_unit_test,
    "imu_calibration": imu_calibration,
    "imu_bias": imu_bias,
    "magnetometer": magnetometer,
    "fog_north": fog_north,
    "rlg_lock_in": rlg_lock_in,
    "imu_six_position": imu_six_position,
    "imu_multi_position": imu_multi_position,
    "imu_strapdown": imu_strapdown,
    "time_sync": time_sync,
}


def analysis_module(name: str) -> AnalysisModule:
    """The module of an analysis. Raises FitError B-FIT-011 for an unknown name."""
    try:
        return ANALYSES[name]
    except KeyError:
        close = difflib.get_close_matches(name, ANALYSES, n=1)
        raise FitError(
            "B-FIT-011",
            f"unknown analysis {name!r}",
            next_step=f"did you mean {close[0]!r}?" if close else f"use one of: {', '.join(ANALYSES)}",
        ) from None


def analyse(material: Material, method: str | None = None) -> Analysis:
    """Run the analysis the campaign names, with its default method (the first it lists) unless told otherwise."""
    module = analysis_module(str(material.campaign.get("analysis", "")))
    return module.analyse(material, method or module.METHODS[0])
