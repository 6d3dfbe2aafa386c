"""HP 6632B system supply (20 V, 5 A): power of the unit under test.

Limits are set before the output can be switched on, the over-voltage trip before the voltage. A tripped protection
stays latched while OUTP? says on; clearing it is a decision of a person (``OUTP:PROT:CLE`` by hand), for the output
comes back with it. What else a last user may have left stands in the state table.

Source: HP 6631B/6632B/6633B/6634B operating and programming guides (VOLTage, CURRent, VOLTage:PROTection,
CURRent:PROTection:STATe, OUTPut, OUTPut:PROTection:DELay, questionable status bits 0, 1, 4, 9, MEASure); libsigrok,
src/hardware/scpi-pps/profiles.c (OUT 0 of the 6632A, for a 6632B after SYST:LANG COMP). The model ends at 20.475 V; a
28 V unit needs the 6633B. Not confirmed on hardware: programming ranges 20.475 V, 5.1188 A and 22 V over-voltage, and
the read-back resolutions.
"""

from __future__ import annotations

from bench.model.ports import Effect, Figure, Parameter, Tells, action, is_one
from instruments.commands import Setting
from instruments.scpi import ScpiSupply
from instruments.values import read_integer, read_number

_VOLTAGE_STEP_V = 0.01
_CURRENT_STEP_A = 0.005
_TRIP_STEP_V = 0.15
_DELAY_s, _DELAY_STEP_s = 0.08, 0.01  # from a change of the output until its protections act, as after *RST
_PROTECTIONS = {1: "over-voltage", 2: "over-current", 16: "over-temperature", 512: "remote-inhibit"}


class Hp6632B(ScpiSupply):
    """Control of the supply with current limit, over-current and over-voltage protection."""

    identity_pattern = r"(HEWLETT-PACKARD|HP|AGILENT.*|KEYSIGHT.*),6632B"
    language = "SCPI (switch its output off at the front panel, then SYST:LANG SCPI by hand)"
    tells = Tells(
        {"OUTP?": is_one},
        {"MEAS:VOLT?": Figure("voltage", "V", read_number), "MEAS:CURR?": Figure("current", "A", read_number)},
    )

    @action(
        Parameter("voltage", "V", 0.0, 20.475),
        Parameter("current_limit", "A", 0.0, 5.1188),
        Parameter("over_voltage", "V", 0.0, 22.0),
        effect=Effect.POWER,
        bus_s=0.8,
    )
    def configure(self, voltage: float, current_limit: float, over_voltage: float) -> None:
        """Set current limit (A), over-voltage trip (V) and voltage (V), over-current trip on; read all back.

        Raises: InstrumentError B-INST-008 (also when the trip is not above the voltage), B-INST-005, B-INST-011.
        """
        if over_voltage <= voltage:
            raise self.refusal(f"configure: over_voltage {over_voltage!r} V is not above voltage {voltage!r} V")
        self.kept = ()
        of_current = self.put(Setting("CURR?", current_limit, _CURRENT_STEP_A, "A"))
        self.bring("configure")  # behind the limit: with that of another user the over-current protection might trip
        self.set(f"OUTP:PROT:DEL {_DELAY_s:g}", self.number("OUTP:PROT:DEL?", _DELAY_s, _DELAY_STEP_s))
        settings = [
            Setting("VOLT:PROT?", over_voltage, _TRIP_STEP_V, "V"),
            Setting("VOLT?", voltage, _VOLTAGE_STEP_V, "V"),
        ]
        if self.ask("VOLT?", read_number) > over_voltage:
            settings.reverse()  # an output that another user left on would trip
        self.keep(of_current, *map(self.put, settings))

    @action(effect=Effect.POWER, bus_s=0.5)
    def output_on(self) -> None:
        """Set the output on, if limits and voltage still read back, and confirm it.

        Raises: InstrumentError B-INST-010 before ``configure``, B-INST-011, B-INST-019 (a protection is latched),
                B-INST-018 (one trips).
        """
        self.require_kept("output_on", "limits were", "configure it first")
        self._recheck()
        self.bring("output_on")
        self.switch_output_on()
        self.clock.sleep(_DELAY_s + _DELAY_STEP_s)
        latched = self.ask("STAT:QUES:COND?", read_integer)
        if names := [name for bit, name in _PROTECTIONS.items() if latched & bit]:
            self.switch_output_off()
            message = f"{' and '.join(names)} latched: there is no voltage though OUTP? said on; the output is off"
            raise self.error("B-INST-018", message, "find the cause, then clear it by hand (OUTP:PROT:CLE)")

    def _safe_command(self) -> str:
        """Return OUTP OFF and, for one left in the language of the 6632A, OUT 0; nothing there tells whether it is off.

        Which of the two it speaks is not switched here: what SYST:LANG does to an output that is on is not public.
        """
        return super()._safe_command() and "OUTP OFF\nOUT 0"

    @action(bus_s=0.3, returns="V")
    def measure_voltage(self) -> float:
        """Measure the output voltage, volt."""
        return self.ask("MEAS:VOLT?", read_number)

    @action(bus_s=0.3, returns="A")
    def measure_current(self) -> float:
        """Measure the output current, ampere."""
        return self.ask("MEAS:CURR?", read_number)


DRIVER = Hp6632B
