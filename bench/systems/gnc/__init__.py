"""GNC modules and inertial units: unit test, calibration, bias, magnetometer, logs of other systems."""
