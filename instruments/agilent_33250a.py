"""Agilent 33250A function generator: the 10 MHz square wave that times the unit's master clock.

Source: 33250A User's Guide, remote interface (FUNCtion, FREQuency, VOLTage, OUTPut:LOAD, OUTPut:POLarity, BURSt,
SWEep, AM, FM, FSKey, SYSTem:ERRor?) and specifications (square 1 uHz to 80 MHz; 20 mVpp to 20 Vpp into an open
circuit). The load setting doubles the amplitude when it is wrong; this driver always says high impedance, so
amplitudes are those at an open output.
"""

from __future__ import annotations

from bench.model.ports import Figure, Parameter, Tells, action, is_one
from instruments.commands import Setting
from instruments.scpi import ScpiOutput
from instruments.values import read_number

_FREQUENCY_STEP_HZ = 1e-6
_AMPLITUDE_STEP_V = 1e-3


class Agilent33250A(ScpiOutput):
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

        What another user left is set first (state table), in an order that is never a conflict (-221): burst, sweep
        and modulation off, the duty cycle before a square wave that would not have it, the offset before the amplitude.

        Raises: InstrumentError B-INST-008, B-INST-005, B-INST-011.
        """
        self.kept = ()
        self.bring("square")
        of_frequency = self.put(Setting("FREQ?", frequency, _FREQUENCY_STEP_HZ, "Hz"))
        self.keep(of_frequency, self.put(Setting("VOLT?", amplitude, _AMPLITUDE_STEP_V, "V")))

    @action(bus_s=0.2)
    def output_on(self) -> None:
        """Set the output on, if the waveform still reads back, and confirm it; what was altered by hand is set again.

        Raises: InstrumentError B-INST-010 before ``square``, B-INST-011.
        """
        self.require_kept("output_on", "waveform was", "set the waveform")
        self.bring("output_on")
        self._recheck()
        self.switch_output_on()

    @action(bus_s=0.2)
    def output_off(self) -> None:
        """Set the output off and confirm it. Raises: InstrumentError B-INST-009."""
        self.switch_output_off()


DRIVER = Agilent33250A
