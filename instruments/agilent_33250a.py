"""Agilent 33250A function generator: the 10 MHz square wave that times the unit's master clock.

Source: 33250A User's Guide, remote interface (FUNCtion, FREQuency, VOLTage, OUTPut:LOAD, OUTPut:POLarity, BURSt,
SWEep, AM, FM, FSKey, SYSTem:ERRor?) and specifications (square 1 uHz to 80 MHz; 20 mVpp to 20 Vpp into an open
circuit). The load setting doubles the amplitude when it is wrong; this driver always says high impedance, so
amplitudes are those at an open output.
"""

from __future__ import annotations

from bench.model.ports import Figure, Parameter, Tells, action, is_one
from instruments.commands import Setting, either
from instruments.scpi import ScpiInstrument
from instruments.values import OVERLOAD_FROM, read_number

_FREQUENCY_STEP_HZ = 1e-6
_AMPLITUDE_STEP_V = 1e-3
_DUTY_STEP_PERCENT = 0.1
_LEFT_OVER = ("BURS:STAT", "SWE:STAT", "AM:STAT", "FM:STAT", "FSK:STAT")  # of the last user


class Agilent33250A(ScpiInstrument):
    """Control of a square wave symmetric about zero."""

    identity_pattern = r".*,33250A"
    safe_state = "output off (OUTP OFF), confirmed by OUTP?"
    tells = Tells(
        {"OUTP?": is_one},
        {"FREQ?": Figure("frequency", "Hz", read_number), "VOLT?": Figure("amplitude", "V", read_number)},
    )

    @action(Parameter("frequency", "Hz", 1e-6, 80e6), Parameter("amplitude", "V", 0.02, 20.0), bus_s=0.8)
    def square(self, frequency: float, amplitude: float) -> None:
        """Set a square wave: ``frequency`` hertz with every digit, ``amplitude`` volt peak to peak, no offset.

        What another user left is set first, in an order that is never a conflict (-221): burst, sweep and modulation
        off, the offset before the amplitude, the duty cycle before a frequency that would not have it.

        Raises: InstrumentError B-INST-008, B-INST-005, B-INST-011.
        """
        frequency, amplitude = self.checked("square", frequency=frequency, amplitude=amplitude)
        self.kept = ()
        for left_over in _LEFT_OVER:
            self.set(f"{left_over} OFF", self.switch(f"{left_over}?", 0))
        self.set("VOLT:OFFS 0", self.number("VOLT:OFFS?", 0.0, _AMPLITUDE_STEP_V))
        self.set("FUNC SQU", self.word("FUNC?", "SQU"))
        self.set("OUTP:LOAD INF", either(self._load_is_infinite, True))
        self.set("OUTP:POL NORM", self.word("OUTP:POL?", "NORM"))
        self.set("FUNC:SQU:DCYC 50", self.number("FUNC:SQU:DCYC?", 50.0, _DUTY_STEP_PERCENT))
        of_frequency = self.put(Setting("FREQ?", frequency, _FREQUENCY_STEP_HZ, "Hz"))
        self.set("VOLT:UNIT VPP", self.word("VOLT:UNIT?", "VPP"))
        self.keep(of_frequency, self.put(Setting("VOLT?", amplitude, _AMPLITUDE_STEP_V, "V")))

    @action(bus_s=0.2)
    def output_on(self) -> None:
        """Set the output on, if the waveform still reads back, and confirm it.

        Raises: InstrumentError B-INST-010 before ``square``, B-INST-011.
        """
        self.require_kept("output_on", "waveform was", "set the waveform")
        self._recheck()
        self.switch_output_on()

    @action(bus_s=0.2)
    def output_off(self) -> None:
        """Set the output off and confirm it. Raises: InstrumentError B-INST-009."""
        self.switch_output_off()

    def _load_is_infinite(self) -> bool:
        return abs(self.ask("OUTP:LOAD?", float)) >= OVERLOAD_FROM

    def _safe_command(self) -> str:
        return "OUTP OFF"

    def _go_safe(self) -> None:
        self.switch_output_off()


DRIVER = Agilent33250A
