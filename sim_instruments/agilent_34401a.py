"""Simulated HP/Agilent 34401A multimeter at the source that the world wires to it, else on rail 1 (+6 V output) of the
auxiliary supply, or where the world says if there is none.

Source: 34401A User's Guide (CONFigure, READ?, INITiate, FETCh?, NPLCycles, ZERO:AUTO, overload reading 9.9E37).
"""

from __future__ import annotations

from typing import Any, ClassVar

from sim_instruments.agilent_e3631a import AgilentE3631A
from sim_instruments.bus.ohms import RESOLUTION, Ohmmeter, OhmsSetting
from sim_instruments.bus.scpi import Answers, ScpiDevice, ScpiError, command, words

RANGES_V = (0.1, 1.0, 10.0, 100.0, 1000.0)
OVERLOAD = 9.9e37
GAIN_SIGMA, OFFSET_SIGMA_V = 1e-5, 2e-5
TWO_WIRE_OHM = 0.2
LINE_HZ = 50.0


class Agilent34401A(ScpiDevice):
    """Volts and ohms with errors drawn once; a reading takes twice the integration time (autozero).

    Autozero can be switched off for volts and two-wire ohms; selecting four wires switches it on.
    """

    identity = "HEWLETT-PACKARD,34401A,0,11-5-2"
    answers: ClassVar[Answers] = {
        "[:SENSe]:FRESistance:NPLCycles?": lambda self: f"{10.0 if self.ohms is None else self.ohms.cycles:+.8E}",
        "[:SENSe]:ZERO:AUTO?": lambda self: str(int(self.autozero)),
    }

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._ohmmeter = Ohmmeter(self, "34401A", TWO_WIRE_OHM)
        self._gain = float(self.rng("34401A gain").normal(1.0, GAIN_SIGMA))
        self._offset_V = float(self.rng("34401A offset").normal(0.0, OFFSET_SIGMA_V))
        self._noise = self.rng("34401A noise")

    def reset(self) -> None:
        self.range_V: float | None = None  # autorange
        self.power_line_cycles = 10.0
        self.ohms: OhmsSetting | None = None  # volts
        self.autozero = True
        self._last = ""

    @property
    def reading_s(self) -> float:
        """Time of one reading, second."""
        cycles = self.power_line_cycles if self.ohms is None else self.ohms.cycles
        return cycles / LINE_HZ * (2 if self.autozero else 1)

    def _true_V(self) -> float:
        source, supply = self.world.terminals.source(self.role), self.partner(AgilentE3631A)
        if source is not None:
            return source.voltage_V(self.now_ns)
        return float(supply.output(0)[0] if supply is not None else self.world.rail_V)

    def _measure(self) -> str:
        self.reply_after(self.reading_s)
        if self.ohms is not None:
            return self.reading(self._ohmmeter.reading(self.ohms, self.world.terminals.source(self.role)))
        true_V = self._true_V()
        if self.range_V is not None and abs(true_V) > 1.2 * self.range_V:
            return f"{OVERLOAD if true_V > 0 else -OVERLOAD:+.8E}"
        return self.reading(f"{true_V * self._gain + self._offset_V + self._noise.normal(0.0, 2e-6):+.8E}")

    @command(":CONFigure:VOLTage[:DC]")
    def _configure(self, text: str) -> None:
        first = (words(text) or ["DEF"])[0].upper()
        self.range_V = None if first in ("DEF", "AUTO") else self._range(first)
        self.power_line_cycles = 10.0
        self.ohms, self.autozero = None, True

    @command(":CONFigure:FRESistance")
    def _configure_four_wires(self, text: str) -> None:
        self.ohms, self.autozero = self._ohmmeter.configured(4, words(text), 10.0), True

    @command(":CONFigure:RESistance")
    def _configure_two_wires(self, text: str) -> None:
        self.ohms, self.autozero = self._ohmmeter.configured(2, words(text), 10.0), True

    def _range(self, text: str) -> float:
        largest_V = self.number(text, RANGES_V[0], RANGES_V[-1])
        return next(r for r in RANGES_V if largest_V <= r)

    @command("[:SENSe]:VOLTage[:DC]:NPLCycles")
    def _set_cycles(self, text: str) -> None:
        cycles = self.number(text, 0.02, 100.0)
        self.power_line_cycles = next(c for c in (0.02, 0.2, 1.0, 10.0, 100.0) if cycles <= c)

    @command("[:SENSe]:FRESistance:NPLCycles")
    def _set_ohms_cycles(self, text: str) -> None:
        cycles = self._ohmmeter.cycles_of(text)
        if self.ohms is not None:
            self.ohms.cycles = cycles

    @command("[:SENSe]:ZERO:AUTO")
    def _set_autozero(self, text: str) -> None:
        on = self.word(text, "ON", "OFF", "ONCE") == "ON"
        if self.ohms is None or self.ohms.wires == 2:
            self.autozero = on

    @command(":CONFigure?")
    def _get_configuration(self, _: str) -> str:
        if self.ohms is not None:
            range_ohm = self.ohms.range_ohm or 100.0
            return f'"{self.ohms.name} {range_ohm:+.6E},{RESOLUTION[self.ohms.cycles] * range_ohm:+.6E}"'
        return f'"VOLT {self.range_V or 10.0:+.6E},+3.000000E-06"'

    @command(":READ?")
    def _read(self, _: str) -> str:
        self._last = self._measure()
        return self._last

    @command(":MEASure:VOLTage[:DC]?")
    def _measure_voltage(self, text: str) -> str:
        self._configure(text)
        return self._read("")

    @command(":MEASure:FRESistance?")
    def _measure_four_wires(self, text: str) -> str:
        self._configure_four_wires(text)
        return self._read("")

    @command(":INITiate")
    def _start(self, _: str) -> None:
        self._last = self._measure()
        self.busy(self.reading_s)

    @command(":FETCh?")
    def _fetch(self, _: str) -> str:
        if not self._last:
            raise ScpiError(-230, "Data stale")
        self._complete("")
        return self._last


SIMULATOR = Agilent34401A
