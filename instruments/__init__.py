"""Drivers of real instruments, one model per file; each file names its class ``DRIVER``. No physics here."""

__bench__ = "inertial-bench"
__simulators__ = "sim_instruments"
