"""Thermotron chamber controllers, dialects "3800" and "8800" (option ``dialect``), temperature channel 1.

The 8800 answers every operation with a completion number, 0 = done, which must be read; the 3800 answers only queries
and needs more than a second after each operation. There is no error queue: alarms (``ALRM1?``) take its place. Chamber
air is not the temperature of the unit under test; a soak is judged by the unit's own sensor.

Source: Thermotron 8800 interface command descriptions (ALRM, AUXE and their replies); 3800 commands and mode bits as in
public drivers. Not confirmed on hardware: ``MRMP1,r`` in degC per minute and its read-back, ``IDEN?`` and its reply,
``HOLD``, the mode bits of the 8800, the range -68 to 177 degC and the fastest ramp. A chamber's own limits and
thermostat stay the safety function.
"""

from __future__ import annotations

from typing import Any, ClassVar

from bench.model.ports import Effect, Identity, Parameter, action
from instruments.base import BaseInstrument
from instruments.values import plain_form, read_integer, read_number, read_text

_MANUAL_RUNS = 1 << 4
_ANY_RUN = 1 << 0 | _MANUAL_RUNS  # program or manual
_MODE_LIMIT_S = 3.0
_MODE_POLL_S = 0.5
_ALARMS = ((0, "low deviation"), (1, "high deviation"), (4, "low process limit"), (5, "high process limit"))
_PROCESS_ALARM = "process limit"
_PAUSE_3800_S = 1.2
_STEP = 0.051  # the controller keeps one decimal of degC and of degC/min
_DIALECTS = ("3800", "8800")


class Thermotron3800(BaseInstrument):
    """Control of the chamber in manual mode: a set-point approached with a ramp."""

    identity_pattern = r"THERMOTRON,(3800|8800)"
    safe_state = "stopped (STOP), heating and cooling off, confirmed by MODE?"
    default_options: ClassVar[dict[str, Any]] = {"dialect": "3800"}

    @action(
        Parameter("temperature", "degC", -68.0, 177.0),
        Parameter("ramp", "degC/min", 0.1, 20.0),
        effect=Effect.THERMAL,
        bus_s=3.0,
    )
    def set_temperature(self, temperature: float, ramp: float) -> None:
        """Set the ramp (degC/min), then the air set-point (degC), and read both back; ``run`` starts the chamber.

        Raises: InstrumentError B-INST-008, B-INST-005 (refused or process alarm), B-INST-011.
        """
        temperature, ramp = self.checked("set_temperature", temperature=temperature, ramp=ramp)
        self.set(f"MRMP1,{plain_form(ramp)}")
        self.set(f"SETP1,{plain_form(temperature)}")
        self.confirm("MRMP1?", ramp, _STEP, "degC/min")
        self.confirm("SETP1?", temperature, _STEP, "degC")

    @action(effect=Effect.THERMAL, bus_s=2.0)
    def run(self) -> None:
        """Set the chamber running in manual mode and confirm it. Raises: InstrumentError B-INST-011."""
        self.set("RUNM")
        if not self.poll(lambda: bool(self._mode() & _MANUAL_RUNS), _MODE_LIMIT_S, _MODE_POLL_S):
            raise self.error("B-INST-011", "MODE? does not read back manual run after RUNM", "look at its display")

    @action(effect=Effect.THERMAL, bus_s=2.0)
    def hold(self) -> None:
        """Set the chamber on hold: conditions stay, a ramp stands still."""
        self.set("HOLD")

    @action(effect=Effect.THERMAL, bus_s=2.0)
    def stop(self) -> None:
        """Set heating and cooling off and confirm it. Raises: InstrumentError B-INST-009."""
        self._ready()
        self._go_safe()

    @action(returns="degC")
    def measure_air(self) -> float:
        """Measure the air temperature at the controller's own sensor, degC."""
        return self.ask("PVAR1?", read_number)

    def set(self, command: str) -> None:
        """Send one operation and read its completion (8800) or pause (3800); process alarms raise B-INST-005."""
        self._ready()
        if (completion := self._operate(command)) != 0:
            raise self.error("B-INST-005", f"{command!r} was refused with completion {completion}")
        alarms = [alarm for alarm in self.drain_errors() if _PROCESS_ALARM in alarm]
        if alarms:
            raise self.error("B-INST-005", f"after {command!r} the chamber reports: {'; '.join(alarms)}")

    def drain_errors(self) -> list[str]:
        """Get the alarms that stand now; reading does not clear them."""
        standing = self.bus.query("ALRM1?", read_integer, self.timeout_s, repeatable=False)
        return [f"{name} alarm" for bit, name in _ALARMS if standing >> bit & 1]

    def raw(self, command: str) -> str | None:
        """Control by hand; an operation of the 8800 returns its completion number."""
        if "?" not in command and self.options["dialect"] == "8800":
            self._ready()
            return self.bus.query(command, str, self.timeout_s, repeatable=False)
        return super().raw(command)

    def _operate(self, command: str) -> int:
        if self.options["dialect"] == "8800":
            return self.bus.query(command, read_integer, self.timeout_s, repeatable=False)
        self.bus.write(command, self.timeout_s)
        self.clock.sleep(_PAUSE_3800_S)
        return 0

    def _mode(self) -> int:
        return self.ask("MODE?", read_integer)

    def _check_options(self) -> None:
        if self.options["dialect"] not in _DIALECTS:
            raise self.bad_option(f"dialect {self.options['dialect']!r} is neither 3800 nor 8800")

    def _ask_identity(self) -> Identity:
        reply = self.bus.query("IDEN?", read_text, self.timeout_s)
        dialect = str(self.options["dialect"])
        return Identity("THERMOTRON", dialect if dialect in reply else reply, "", reply)

    def _go_safe(self) -> None:
        self._operate("STOP")  # refused when it is stopped already: the mode decides
        if not self.poll(lambda: not self._mode() & _ANY_RUN, _MODE_LIMIT_S, _MODE_POLL_S):
            raise self.error("B-INST-009", "MODE? still reads back a run after STOP", "switch the chamber off")


DRIVER = Thermotron3800
