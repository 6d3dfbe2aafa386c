"""What can be chosen at the simulated bench of GNC modules; every switch is on where none is given."""

from __future__ import annotations

from sim_instruments.worlds.gnc.faults import parse_faults

OPTIONS = {
    "imu_errors": "scale, cross terms, biases and temperature effects of the sensors, iron at the magnetometer",
    "noise": "noise, bias instability and turn-on bias of the sensors",
}
NUMBERS = {"tilt_arcmin": ("tilt of the unit on the table, standard deviation by axis and pose, 0 to 60", 0.0, 60.0)}
TEXTS = {"faults": ("faults of units by serial number, GNC-02=flash_weak_cell,GNC-03=gps_silent+io_open", parse_faults)}
