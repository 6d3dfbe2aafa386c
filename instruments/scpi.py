"""Instruments with the error queue of SCPI (SCPI-99 vol. 2, 21.8: SYSTem:ERRor?): those with an output, with ohms."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

from bench.model.errors import InstrumentError
from bench.model.ports import Effect, Identity, Parameter, action
from instruments.base import BaseInstrument
from instruments.bus import TIMED_OUT
from instruments.values import read_integer, read_number

RANGES_OHM = (1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)  # of the 34401A and the 34970A
T = TypeVar("T")
_ERROR = re.compile(r'([+-]?\d+)\s*,\s*"?(.*?)"?', re.DOTALL)


def read_scpi_error(reply: str) -> str | None:
    """Return the error of a ``SYST:ERR?`` reply such as ``-222,"Data out of range"``, or None for number 0.

    Raises: ValueError if the reply has another form.
    """
    match = _ERROR.fullmatch(reply)
    if match is None:
        raise ValueError('number,"text" is due')
    return None if int(match[1]) == 0 else f"{int(match[1])} {match[2]}"


def is_range(configuration: str, range_ohm: float) -> bool:
    """Return whether a ``CONF?`` reply such as ``"FRES +1.000000E+02,+3.000000E-04"`` is four wires on this range."""
    name, _, parameters = configuration.strip('"').upper().partition(" ")
    return name == "FRES" and read_number(parameters.partition(",")[0]) == range_ohm


class ScpiInstrument(BaseInstrument):
    """A driver of an instrument that answers ``*IDN?`` and ``SYST:ERR?``.

    ``language``: what to choose on one that may be left in a language in which it answers neither.
    """

    language: ClassVar[str] = ""

    def measured(self, parse: Callable[[str], T], patience_s: float) -> T:
        """Measure by ``READ?``, which may take ``patience_s`` (second), and read the error queue empty."""
        value = self.ask("READ?", parse, patience_s=patience_s)
        self.check_errors("READ?")
        return value

    def abort(self) -> None:
        """Set an end to what is measured (``ABOR``): the safe state of what drives nothing."""
        self.bus.write("ABOR", self.timeout_s)
        self.drain_errors()

    def output_is_on(self) -> bool:
        """Get whether the output is switched on (``OUTP?``)."""
        return self.ask("OUTP?", read_integer) == 1

    def switch_output_off(self) -> None:
        """Set the output off, whatever the error queue holds. Raises: InstrumentError B-INST-009 if it stays on."""
        self._ready()
        if not self.switch_off("OUTP OFF", lambda: not self.output_is_on()):
            raise self.error("B-INST-009", "the output is still on after OUTP OFF", "switch it off at the front panel")

    def switch_output_on(self) -> None:
        """Set the output on and confirm it. Raises: InstrumentError B-INST-011."""
        self.set("OUTP ON", self.switch("OUTP?", 1))
        self.confirm("OUTP?", 1, 0, "")

    def _ask_identity(self) -> Identity:
        try:
            return super()._ask_identity()
        except InstrumentError as error:
            if self.language and error.code == TIMED_OUT:
                error.next_step += f"; choose {self.language} if it was left in another language"
            raise

    def _next_error(self) -> str | None:
        return self.bus.query("SYST:ERR?", read_scpi_error, self.timeout_s, repeatable=False)


class ScpiOutput(ScpiInstrument):
    """An instrument with an output that goes off in the safe state, unless the option ``safe_state`` keeps it."""

    def _safe_command(self) -> str:
        return "" if self.options.get("safe_state") == "keep" else "OUTP OFF"

    def _go_safe(self) -> None:
        if self._safe_command():
            self.switch_output_off()
        else:
            self.drain_errors()


class ScpiSupply(ScpiOutput):
    """A supply, whose output goes off in the safe state (option ``safe_state`` off) or stays as it is (keep)."""

    safe_state = "output off (OUTP OFF), confirmed by OUTP?; with option safe_state keep as it is"
    default_options: ClassVar[dict[str, Any]] = {"safe_state": "off"}
    option_limits = (Parameter("safe_state", choices=("off", "keep")),)

    @action(effect=Effect.POWER, bus_s=0.3)
    def output_off(self) -> None:
        """Set the output off, of all rails if there are more, and confirm it. Raises: InstrumentError B-INST-009."""
        self.switch_output_off()
