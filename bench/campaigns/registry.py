"""Analyses by name: a campaign names its analysis, the registry names the module that does it."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Protocol

from bench.campaigns import (
    bias_ramp,
    dmm_method,
    fog_north,
    gnc_unit_test,
    imu_bias,
    imu_calibration,
    imu_multi_position,
    imu_six_position,
    imu_strapdown,
    magnetometer,
    rlg_lock_in,
    scale_factor,
    temperature_ramp,
    time_sync,
)
from bench.campaigns.analysis import Analysis
from bench.campaigns.material import Material
from bench.model.errors import FitError


class AnalysisModule(Protocol):
    """What a file in bench/campaigns offers to be an analysis."""

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
