"""Controller of an unattended calibration bench for inertial-navigation electronics."""

__version__ = "0.1.0"
__bench__ = "inertial-bench"
