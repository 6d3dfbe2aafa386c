"""Example T100 thermometer: a sensor that reads while its excitation is on. No instrument of this name is for sale.

Source: this page. Commands: ``OUTP ON|OFF``, ``OUTP?``, ``MEAS:TEMP?`` (degC), ``*IDN?``, ``SYST:ERR?``.
"""

from __future__ import annotations

from bench.model.ports import Effect, action
from instruments.scpi import ScpiSupply
from instruments.values import read_number


class ExampleT100(ScpiSupply):
    """Measurement of a temperature; the excitation goes off in the safe state."""

    identity_pattern = r"EXAMPLE,T100"

    @action(effect=Effect.POWER, bus_s=0.3)
    def excitation_on(self) -> None:
        """Set the excitation on and confirm it. Raises: InstrumentError B-INST-011."""
        self.switch_output_on()

    @action(bus_s=0.3, returns="degC")
    def measure_temperature(self) -> float:
        """Measure the temperature, degC. Raises: InstrumentError B-INST-005 (the excitation is off)."""
        value = self.ask("MEAS:TEMP?", read_number)
        self.check_errors("MEAS:TEMP?")
        return value


DRIVER = ExampleT100
