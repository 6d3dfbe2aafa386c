"""Agilent E3631A triple supply: auxiliary rails. Rail 1 = +6 V/5 A, 2 = +25 V/1 A, 3 = -25 V/1 A.

The selected rail is hidden state of the instrument, so selecting and using it happen under the bus lock.

Source: E3631A User's Guide (INSTrument:NSELect, VOLTage, CURRent, MEASure, OUTPut). Not confirmed on hardware: the
programming ranges 6.18 V/5.15 A and 25.75 V/1.03 A, and the read-back resolutions.
"""

from __future__ import annotations

from collections.abc import Mapping

from bench.model.ports import Effect, Parameter, Tells, action, is_one
from instruments.commands import Setting
from instruments.scpi import ScpiSupply
from instruments.values import read_number

# rail: lowest voltage (V), highest voltage (V), highest current (A)
_RAILS = {1: (0.0, 6.18, 5.15), 2: (0.0, 25.75, 1.03), 3: (-25.75, 0.0, 1.03)}
_VOLTAGE_STEP_V = 0.005
_CURRENT_STEP_A = 0.002
_RAIL = Parameter("rail", choices=tuple(_RAILS))


class AgilentE3631A(ScpiSupply):
    """Control and measurement of the three rails; one switch turns all three on and off."""

    identity_pattern = r"(HEWLETT-PACKARD|HP|AGILENT.*|KEYSIGHT.*),E3631A"
    tells = Tells({"OUTP?": is_one})
    remote = "SYST:REM"

    configured: Mapping[int, tuple[Setting, ...]] = {}  # by rail; ``kept`` are those of the selected
    selected = 0

    @action(
        _RAIL,
        Parameter("voltage", "V", -25.75, 25.75),
        Parameter("current_limit", "A", 0.0, 5.15),
        effect=Effect.POWER,
        bus_s=0.5,
    )
    def configure(self, rail: int, voltage: float, current_limit: float) -> None:
        """Set current limit (A) and voltage (V, negative on rail 3) of one rail and read both back.

        Raises: InstrumentError B-INST-008 (limits of the rail), B-INST-005, B-INST-011.
        """
        low_V, high_V, high_A = _RAILS[rail]
        if not (low_V <= voltage <= high_V and current_limit <= high_A):
            message = f"configure: rail {rail} takes {low_V} to {high_V} V and up to {high_A} A, not {voltage!r} V, "
            raise self.refusal(f"{message}{current_limit!r} A")
        with self.bus.lock:
            self.configured = {other: set_ for other, set_ in self.configured.items() if other != rail}
            self._select(rail)
            wanted = (
                Setting("CURR?", current_limit, _CURRENT_STEP_A, "A"),
                Setting("VOLT?", voltage, _VOLTAGE_STEP_V, "V"),
            )
            self.keep(*map(self.put, wanted))
        self.configured = {**self.configured, rail: self.kept}

    @action(effect=Effect.POWER, bus_s=1.5)
    def output_on(self) -> None:
        """Set all outputs on, if what was set still reads back on the rails, and confirm it.

        One switch serves all three: a rail that this run has not set is set to 0 V first.

        Raises: InstrumentError B-INST-010 before ``configure``, B-INST-011.
        """
        if not self.configured:
            raise self.error("B-INST-010", "output_on refused: no rail was set by this run", "configure it first")
        with self.bus.lock:
            for rail in sorted(set(_RAILS) - set(self.configured)):
                self._select(rail)
                self.confirm(*self.put(Setting("VOLT?", 0.0, _VOLTAGE_STEP_V, "V")))
            for rail in self.configured:
                self._select(rail)
                self.confirm_kept()
            self.switch_output_on()

    @action(_RAIL, bus_s=0.5, returns="V")
    def measure_voltage(self, rail: int) -> float:
        """Measure the voltage of one rail, volt (negative on rail 3)."""
        with self.bus.lock:
            self._select(rail)
            return self.ask("MEAS:VOLT?", read_number)

    def _select(self, rail: int) -> None:
        if rail != self.selected:
            self.seen.clear()  # it was about another rail
        self.selected, self.kept = 0, ()
        self.set(f"INST:NSEL {rail}", self.number("INST:NSEL?", rail, 0))
        self.selected, self.kept = rail, self.configured.get(rail, ())

    def _recheck(self) -> None:
        """Look at the rail that is selected; another one would be answered for it."""
        if self.selected:
            self.confirm("INST:NSEL?", self.selected, 0, "")
        self.confirm_kept()

    def _forget(self) -> None:
        super()._forget()
        self.configured = {}


DRIVER = AgilentE3631A
