"""Agilent 53230A universal counter: frequency of input 1 against the external 10 MHz reference.

Its preparation resets it: mathematics, trigger, input and format of the last user would change what READ? answers, or
whether it does (state table). After the reset the threshold is found anew, at half of the signal.

Source: 53220A/53230A User's Guide (SENSe:FREQuency:GATE, READ?; 69: SENSe:ROSCillator:SOURce, questionable status bit
10 = reference not usable; 131: auto-level after *RST). 9.91E37 is the answer without a signal. The 53131A has other
gate commands and is not served.
"""

from __future__ import annotations

from bench.model.ports import Parameter, action
from instruments.commands import either
from instruments.scpi import ScpiInstrument
from instruments.values import exponent_form, read_integer, read_number, read_text

_REFERENCE_LOST = 1 << 10
_BEYOND_GATE_S = 2.0
_GATE_STEP_S = 1e-6


class Agilent53230A(ScpiInstrument):
    """Measurement of frequency with a timed gate."""

    identity_pattern = r".*,53230A"
    safe_state = "measurement aborted (ABOR); the counter drives nothing"

    @action(Parameter("gate", "s", 1e-3, 10.0), bus_s=12.0, returns="Hz")
    def measure_frequency(self, gate: float) -> float:
        """Measure the frequency of input 1, hertz; the reading is polled for while the gate (second) is open.

        Raises: InstrumentError B-INST-008, B-INST-005, B-INST-007 (no signal), B-INST-001 (gate plus 2 s are over).
        """
        self.bring("measure_frequency")
        has_gate = either(lambda: abs(self.ask("FREQ:GATE:TIME?", read_number) - gate) <= _GATE_STEP_S, True)
        self.set(f"FREQ:GATE:TIME {exponent_form(gate)}", has_gate)
        return self.measured(read_number, gate + _BEYOND_GATE_S)

    @action(bus_s=0.2)
    def reference_locked(self) -> bool:
        """Get whether the external reference is in use and was never lost since the last question."""
        external = self.ask("ROSC:SOUR?", read_text).upper().startswith("EXT")
        lost = self.ask("STAT:QUES:EVEN?", read_integer) & _REFERENCE_LOST
        return external and not lost

    _go_safe = ScpiInstrument.abort


DRIVER = Agilent53230A
