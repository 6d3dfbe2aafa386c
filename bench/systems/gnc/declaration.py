"""Declaration of GNC modules and inertial measurement units."""

from __future__ import annotations

from bench.model.declaration import AnalysisDeclaration, CoefficientsDeclaration, Limit, System
from bench.systems.gnc.sections import HINTS, ModuleUnit, SensorColumn, SensorLog

_HERE = "bench.systems.gnc"
_TAKEN = f"{_HERE}.assumptions"
_POSE = ("item", "mounting", "outer_deg", "middle_deg", "inner_deg")
_TRIADS = ("tick", "gyro", "accel", "temperature")
_FOUND = ("accel_bias", "accel_scale_error", "gyro_bias", "gyro_scale_error")
_INERTIAL = ("time", "gyro", "accelerometer")
_ITEMS = ("supply", "identify", "cpu", "timer", "memory", "imu", "gps", "ad", "io", "spi", "sci", "can")
_DIMENSIONS = {
    "width": "m",
    "depth": "m",
    "height": "m",
    "supply_voltage": "V",
    "supply_voltage_deviation": "1",
    "supply_current": "A",
    "supply_current_deviation": "1",
    "timer_interval_error": "1",
    "timer_ticks": "1",
    "gyro_at_rest": "deg/s",
    "acceleration_error": "g",
    "imu_temperature_low": "degC",
    "imu_temperature_high": "degC",
    "horizontal_error": "m",
    "height_error": "m",
    "gps_satellites": "1",
    "ad_tolerance": "1",
    "ad_ground": "V",
    "ad_field_low": "gauss",
    "ad_field_high": "gauss",
    "gyro_bias_stability": "deg/s",
    "accel_bias_stability": "g",
    "gyro_cross_coupling": "1",
    "accel_cross_coupling": "1",
    "gyro_scale_repeatability": "1",
    "accel_scale_repeatability": "1",
    "roll_error": "deg",
}

DECLARATION = System(
    name="gnc",
    analyses=(
        AnalysisDeclaration(
            "gnc_unit_test",
            f"{_HERE}.unit_test.analysis",
            ("exchanges",),
            made_of="tests",
            items=_ITEMS,
            page="docs/gnc-module.md",
            predicted=f"{_HERE}.predicted:of_unit_test",
        ),
        AnalysisDeclaration(
            "imu_calibration",
            f"{_HERE}.calibration.analysis",
            ("least_squares",),
            made_of="samples",
            conditions=_POSE,
            fields=_TRIADS,
            main=(*_FOUND, "accel_cross_coupling", "gyro_cross_coupling"),
            assumptions=f"{_TAKEN}:of_calibration",
            predicted=f"{_HERE}.predicted:of_calibration",
            design=f"{_HERE}.calibration.design:design",
        ),
        AnalysisDeclaration(
            "imu_bias",
            f"{_HERE}.bias",
            ("ten_second_means",),
            made_of="samples",
            conditions=_POSE,
            fields=_TRIADS,
            main=("gyro_bias", "accel_bias", "gyro_bias_stability", "accel_bias_stability"),
            sizes=("gyro_bias_stability", "accel_bias_stability"),
            assumptions=f"{_TAKEN}:of_bias",
            predicted=f"{_HERE}.predicted:of_bias",
        ),
        AnalysisDeclaration(
            "magnetometer",
            f"{_HERE}.magnetometer",
            ("ellipse", "extremes"),
            made_of="samples",
            conditions=(*_POSE, "rate_deg_s"),
            main=("mag_offset", "mag_gain", "mag_angle"),
            assumptions=f"{_TAKEN}:of_magnetometer",
            predicted=f"{_HERE}.predicted:of_magnetometer",
            fields=("tick", "mag", "temperature"),
        ),
        AnalysisDeclaration(
            "imu_six_position", f"{_HERE}.logs.six_position", ("least_squares",), "logs", roles=_INERTIAL
        ),
        AnalysisDeclaration("imu_multi_position", f"{_HERE}.logs.multi_position", ("norm",), "logs", roles=_INERTIAL),
        AnalysisDeclaration(
            "imu_strapdown", f"{_HERE}.logs.strapdown", ("indicated", "calibrated"), "logs", roles=_INERTIAL
        ),
        AnalysisDeclaration("bias_log", f"{_HERE}.logs.bias", ("allan",), "logs", roles=_INERTIAL),
        AnalysisDeclaration(
            "magnetometer_log",
            f"{_HERE}.logs.magnetometer",
            ("ellipsoid", "turn_about_z"),
            "logs",
            roles=("time", "magnetometer"),
        ),
    ),
    limits={name: Limit(dimension) for name, dimension in _DIMENSIONS.items()},
    unit=ModuleUnit,
    log=SensorLog,
    log_columns=(SensorColumn,),
    log_hints=HINTS,
    coefficients=CoefficientsDeclaration("an IMU", f"{_HERE}.coefficients", f"{_HERE}.coefficients:header_text"),
)
