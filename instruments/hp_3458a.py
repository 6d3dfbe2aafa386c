"""HP/Agilent 3458A digital multimeter, dc current.

Not SCPI. The GPIB END line is off at power-on, so ``END ALWAYS`` is the first thing sent, twice, before the identity
question, and with it ``QFORMAT NORM``, which no preset brings back.
A reading is triggered, then awaited by serial poll (bit 7, reading available), so no bus call blocks for the seconds a
reading at 100 power-line cycles with autozero takes.

Source: 3458A User's Guide (END, ERRSTR?, INBUF, PRESET, STB?, TRIG; DCI ranges and maximum inputs). ``PRESET NORM``
leaves TARM AUTO, so one ``TRIG SGL`` gives one reading, and the input buffer off, with which the bus would be held
until that reading is done (page 187): ``INBUF ON`` behind it. What it brings back besides, and what it leaves alone,
stands in the state table. Not confirmed on hardware: the serial poll bit with memory off, the time that ``LFREQ LINE``
takes, and constant 175 of ``CAL?`` as the temperature of the last ACAL DCV (as in public programs).
"""

from __future__ import annotations

from bench.model.errors import InstrumentError
from bench.model.ports import Identity, Parameter, action
from instruments.base import BaseInstrument
from instruments.bus import DOUBTFUL
from instruments.commands import Setting
from instruments.scpi import read_scpi_error
from instruments.values import exponent_form, read_number

_FULL_RESOLUTION = ("NPLC 100", "NDIG 8", "TRIG HOLD")
_READING_AVAILABLE = 1 << 7
_READING_LIMIT_S = 15.0
_POLL_S = 0.25
_ACAL_DCV_DEGC = 175  # number of the calibration constant
_ACAL_LIMIT_DEGC = 1.0  # specifications hold within 24 h and 1 degC of the last ACAL
# nominal range (A), largest input (A): 120 % of range, but 105 % on the 1 A range
_LOW_RANGES_A = ((1e-7, 1.2e-7), (1e-6, 1.2e-6), (1e-5, 1.2e-5), (1e-4, 1.2e-4))
_RANGES_A = (*_LOW_RANGES_A, (1e-3, 1.2e-3), (1e-2, 1.2e-2), (1e-1, 1.2e-1), (1.0, 1.05))


def read_constant(reply: str) -> float:
    """Return the value in front of the description in a ``CAL?`` reply. Raises: ValueError."""
    return read_number(reply.split(",", maxsplit=1)[0].strip())


class Hp3458A(BaseInstrument):
    """Measurement of dc current at full resolution.

    The meter stands in the current loop, so its range is changed only while no current flows: a relay that moves under
    current would open the loop. Burden (User's Guide): about 75 mV at full scale of the 100 uA range (730 ohm), 100 mV
    of 1 mA (100 ohm) and 10 mA (10 ohm), 250 mV of 100 mA (1 ohm), below 1.5 V of 1 A (0.1 ohm).
    """

    identity_pattern = r"HP,3458A"
    identity_question = "ID?"
    ranges_A = tuple(nominal for nominal, _ in _RANGES_A)
    needs = ("serial poll",)
    safe_state = "trigger on hold (TRIG HOLD); the meter drives nothing"

    warm_up_s = 4 * 3600.0

    def self_calibration(self) -> tuple[float, float, str, str]:
        """Get how far it is from its last ACAL DCV: (found, limit, unit, from what); the age of that it does not tell.

        Raises: InstrumentError if it does not know a question.
        """
        self._ready()
        inside_degC = self.bus.query("TEMP?", read_number, self.timeout_s, repeatable=False)
        question = f"CAL? {_ACAL_DCV_DEGC}"
        acal_degC = self.bus.query(question, read_constant, self.timeout_s, repeatable=False)
        return abs(inside_degC - acal_degC), _ACAL_LIMIT_DEGC, "degC", "from its temperature at the last ACAL DCV"

    @action(Parameter("range", "A", 1e-9, 1.05), bus_s=1.0)
    def configure_current(self, range: float) -> float:  # noqa: A002 - the sequence's word
        """Set dc current on the smallest range that holds ``range`` (ampere), 100 power-line cycles, autozero on.

        Returns the range the meter says it is in, ampere: the readings that follow belong to it.
        Raises: InstrumentError B-INST-008, B-INST-019 (rear terminals), B-INST-005, B-INST-011.
        """
        nominal_A = next(nominal for nominal, limit in _RANGES_A if range <= limit)
        self.kept = ()
        try:
            self._set_up(nominal_A)
        except InstrumentError as doubt:
            if doubt.code not in DOUBTFUL or self.bus.hurried:
                raise
            self.bus.note("tx", "<the set-up begins again: PRESET NORM leaves nothing of it>")
            self._set_up(nominal_A)
        self.kept = (*self.kept, Setting("NPLC?", 100.0, 0.0, ""))  # 10 after power on
        return nominal_A

    @action(bus_s=6.0, returns="A")
    def measure_current(self) -> float:
        """Measure one dc current, ampere. Raises: InstrumentError B-INST-012 (no reading), B-INST-007 (overload)."""
        self._ready()
        self.bus.write("TRIG SGL", self.timeout_s)
        if not self.poll(self._reading_is_there, _READING_LIMIT_S, _POLL_S):
            raise self.error("B-INST-012", f"no reading {_READING_LIMIT_S:g} s after TRIG SGL", "check its set-up")
        current_A = self.bus.read(read_number, "TRIG SGL", self.timeout_s)
        self.check_errors("TRIG SGL")
        return current_A

    def _reading_is_there(self) -> bool:
        return bool(self.bus.status_byte(self.timeout_s) & _READING_AVAILABLE)

    def _set_up(self, nominal_A: float) -> None:
        self.bring("configure_current")
        for command in ("PRESET NORM", "INBUF ON", f"DCI {exponent_form(nominal_A)}", *_FULL_RESOLUTION):
            self.set(command)
        self.keep(Setting("RANGE?", nominal_A, 1e-6 * nominal_A, "A"))

    def _ask_identity(self) -> Identity:
        for _ in range(2):  # half a command that somebody left would swallow one, and nothing tells it
            self.bus.write("END ALWAYS;QFORMAT NORM", self.timeout_s)
        return super()._ask_identity()

    def _identity_of(self, reply: str) -> Identity:
        return Identity("HP", reply.removeprefix("HP"), "", "")

    def _next_error(self) -> str | None:
        return self.bus.query("ERRSTR?", read_scpi_error, self.timeout_s, repeatable=False)

    def _go_safe(self) -> None:
        self.bus.write("TRIG HOLD", self.timeout_s)
        self.drain_errors()


DRIVER = Hp3458A
