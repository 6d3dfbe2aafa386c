"""Choices at the simulated bench of GNC modules: switches, and the faults that a module can have.

Every switch is on where none is given. A fault has a number, says what is wrong and which unit tests must fail because
of it; the table in docs/method-gnc.md says the same, and a test holds the two against each other.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bench.model.errors import InputError

ITEMS = ("supply", "identify", "cpu", "timer", "memory", "imu", "gps", "ad", "io", "spi", "sci", "can")


@dataclass(frozen=True)
class ModuleFault:
    """One fault: ``code`` switches it on by the command "inject"; ``fails`` are the unit tests that must fail."""

    code: int
    wrong: str
    fails: tuple[str, ...]


_FAULTS: Mapping[str, tuple[Any, ...]] = {
    "cpu_carry": (1, "the adder loses the carry from bit 15 to bit 16", "cpu"),
    "cpu_borrow": (2, "the subtracter loses the borrow from bit 15 to bit 16", "cpu"),
    "cpu_multiplier": (3, "the multiplier leaves out the partial product of bit 7", "cpu"),
    "cpu_divider": (4, "bit 0 of every quotient is 0", "cpu"),
    "cpu_register": (5, "bit 19 of the scratch memory reads 1", "cpu"),
    "timer_slow": (6, "the timer's prescaler makes every interval 3 % longer", "timer"),
    "timer_lost_interrupts": (7, "every fifth interrupt of the timer is lost", "timer"),
    "ram_stuck_bit": (8, "one cell of the RAM reads 1", "memory"),
    "ram_coupled_bits": (9, "two cells of the RAM read as the AND of both", "memory"),
    "sdram_address_short": (10, "address lines 9 and 13 of the SDRAM are shorted", "memory"),
    "sdram_data_open": (11, "data line 22 of the SDRAM is open and reads 1", "memory"),
    "flash_weak_cell": (12, "two cells of the SPI FLASH are not erased any more", "memory"),
    "flash_lost_bits": (13, "two cells of the SPI FLASH do not hold a programmed 0", "memory"),
    "internal_flash_worn": (14, "one block of the internal FLASH is worn: erasing leaves scattered 0", "memory"),
    "internal_flash_protected": (15, "the internal FLASH is write-protected", "memory"),
    "gyro_saturated": (16, "gyro Y stands at the end of its range", "imu"),
    "accelerometer_dead": (17, "accelerometer Z gives 0", "imu"),
    "imu_bus_dead": (18, "the inertial sensors do not answer the processor", "imu"),
    "imu_temperature_open": (19, "the temperature of the gyro reads -273 degC", "imu"),
    "imu_frozen": (20, "the inertial sensors repeat one sample for ever", "imu"),
    "gps_no_satellites": (21, "the antenna is open: no satellites, no fix", "gps"),
    "gps_few_satellites": (22, "three satellites only: a fix without height", "gps"),
    "gps_silent": (23, "the satellite receiver does not answer the processor", "gps"),
    "gps_far": (24, "the almanac is old: the position is wrong by a degree", "gps"),
    "ad_offset": (25, "all AD channels read 0.25 V too much", "ad"),
    "ad_reference": (26, "the AD reference is 12 % low: all readings are too high by that", "ad"),
    "ad_channel_open": (27, "the input of AD channel 4 is open: it reads 0 V with its switch on", "ad"),
    "rail_3v3_low": (28, "the 3.3 V regulator gives 2.9 V", "ad"),
    "rail_1v2_high": (29, "the 1.2 V regulator gives 1.4 V", "ad"),
    "ad_ground_lifted": (30, "the GND pin of AD channel 7 is lifted to 0.6 V", "ad"),
    "magnetometer_output_dead": (31, "the analogue output of magnetometer Y stands at 0 V", "ad"),
    "io_stuck_low": (32, "line 2 is shorted to ground", "io", "spi"),
    "io_short": (33, "lines 2 and 3 are shorted", "io", "spi"),
    "io_swapped": (34, "lines 3 and 4 are exchanged", "io", "spi"),
    "io_open": (35, "line 4 does not reach the socket", "io", "spi"),
    "spi_receive_bit": (36, "bit 5 of the SPI receive register is 0", "spi"),
    "spi_lost_clock": (37, "the SPI sends 15 clocks for 16 bits", "spi"),
    "sci_bit_errors": (38, "the SCI converter turns bit 3 of every fourth byte over", "sci"),
    "sci_silent": (39, "nothing comes back over the SCI", "sci"),
    "can_identifier": (40, "bit 2 of the CAN identifier comes back turned over", "can"),
    "can_bus_off": (41, "the CAN transceiver is dead: bus off", "can"),
    "current_high": (42, "a leaky capacitor: 0.05 A more than the module should draw", "supply"),
    "current_low": (43, "one regulator idles: 0.05 A less than the module should draw", "supply"),
    "contact_resistance": (44, "0.9 ohm in the supply contact: too little voltage at the board", "supply", "ad"),
    "supply_short": (45, "5 V is shorted to ground: the module never starts", *ITEMS),
}
FAULTS = {name: ModuleFault(code, wrong, tuple(fails)) for name, (code, wrong, *fails) in _FAULTS.items()}
BY_CODE = {fault.code: name for name, fault in FAULTS.items()}


def parse_faults(text: str) -> dict[str, tuple[str, ...]]:
    """Return faults by serial number from "GNC-02=flash_weak_cell,GNC-03=gps_silent+io_open"; "" and "none" are none.

    Raises: InputError B-SIM-002 for another form or an unknown name.
    """
    faults: dict[str, tuple[str, ...]] = {}
    for part in filter(None, (word.strip() for word in text.split(","))):
        if part == "none":
            continue
        serial, _, names = part.partition("=")
        if not serial.strip() or not names.strip():
            raise InputError(
                "B-SIM-002",
                f"world option faults has the part {part!r}",
                next_step="write SERIAL=FAULT, several faults with '+', several units with ','",
            )
        faults[serial.strip()] = tuple(_known(name.strip()) for name in names.split("+"))
    return faults


def _known(name: str) -> str:
    if name in FAULTS:
        return name
    near = difflib.get_close_matches(name, FAULTS, n=1)
    meant = f"did you mean {near[0]!r}? " if near else ""
    raise InputError(
        "B-SIM-002",
        f"faults: none of the GNC module is called {name!r}",
        next_step=f"{meant}docs/method-gnc.md lists them",
    )


OPTIONS = {
    "imu_errors": "scale, cross terms, biases and temperature effects of the sensors, iron at the magnetometer",
    "noise": "noise, bias instability and turn-on bias of the sensors",
}
NUMBERS = {"tilt_arcmin": ("tilt of the unit on the table, standard deviation by axis and pose, 0 to 60", 0.0, 60.0)}
TEXTS = {"faults": ("faults of units by serial number, GNC-02=flash_weak_cell,GNC-03=gps_silent+io_open", parse_faults)}
