"""Thermotron chamber controllers, dialects "3800" and "8800" (option ``dialect``), temperature channel 1.

The 8800 answers every operation with a completion number, 0 = done, which must be read; the 3800 answers only queries
and needs more than a second after each operation. No error queue is read: alarms (``ALRM1?``) take its place. Chamber
air is not the temperature of the unit under test; a soak is judged by the unit's own sensor.

A program that runs, is on hold or will start is somebody's own: with one of them no set-point is sent and nothing is
set running (state table). The scale of temperatures can be asked of an 8800 alone; on a 3800 a person looks at it once.

Source: Thermotron 8800 interface command descriptions (ALRM, AUXE and their replies); 3800 commands and mode bits as in
public drivers, those of the 8800 (``STAT?`` tells a hold) as in a public class for it. Not confirmed on hardware:
``MRMP1,r`` of a 3800 in degC per minute and its read-back, ``IDEN?`` and its reply, that ``MODE?`` of a 3800 tells a
hold (a public driver names that bit "edit mode, in hold"), the range -68 to 177 degC and the fastest ramp. A chamber's
own limits and thermostat stay the safety function.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from bench.model.ports import Effect, Figure, Identity, Parameter, Tells, action
from instruments.base import BaseInstrument
from instruments.commands import Setting, either
from instruments.values import plain_form, read_integer, read_number

_MANUAL_RUNS = 1 << 4
_ANY_RUN = 1 << 0 | _MANUAL_RUNS  # program or manual
_ON_HOLD = 1 << 3
_HOLDS_8800 = 1 << 1 | 1 << 2 | 1 << 5  # of STAT?: program on hold or suspended, manual on hold
_MODE_LIMIT_S = 3.0
_MODE_POLL_S = 0.5
_ALARMS = ((0, "low deviation"), (1, "high deviation"), (4, "low process limit"), (5, "high process limit"))
_PROCESS_ALARM = "process limit"
_PAUSE_3800_S = 1.2
_STEP = 0.051  # the controller keeps one decimal of degC and of degC/min
_DIALECTS = ("3800", "8800")


def read_mode(reply: str) -> str:
    """Return "running", "on hold" (heating and cooling go on) or "stopped". Raises: ValueError."""
    mode = read_integer(reply)
    if mode & _ON_HOLD:
        return "on hold"
    return "running" if mode & _ANY_RUN else "stopped"


class Thermotron3800(BaseInstrument):
    """Control of the chamber in manual mode: a set-point approached with a ramp."""

    identity_pattern = r"THERMOTRON,(3800|8800)"
    identity_question = "IDEN?"
    safe_state = (
        "on hold if it runs (HOLD, conditions stay), else left stopped, by MODE?; option safe_state stop: stopped"
    )
    default_options: ClassVar[dict[str, Any]] = {"dialect": "3800", "safe_state": "hold"}
    tells = Tells(
        {"MODE?": lambda reply: read_mode(reply) == "running"},
        {
            "MODE?": Figure("mode", "", lambda reply: (read_mode(reply),)),
            "SETP1?": Figure("setpoint", "degC", read_number),
            "PVAR1?": Figure("air", "degC", read_number),
        },
    )

    @action(
        Parameter("temperature", "degC", -68.0, 177.0),
        Parameter("ramp", "degC/min", 0.1, 20.0),
        effect=Effect.THERMAL,
        bus_s=3.0,
    )
    def set_temperature(self, temperature: float, ramp: float) -> None:
        """Set the ramp (degC/min), then the air set-point (degC), and read both back; ``run`` starts the chamber.

        Raises: InstrumentError B-INST-008, B-INST-019 (state table), B-INST-005 (refused or process alarm), B-INST-011.
        """
        self.kept = ()
        self.bring("set_temperature")
        self.set(f"MRMP1,{plain_form(ramp)}", self.number("MRMP1?", ramp, _STEP))
        self.set(f"SETP1,{plain_form(temperature)}", self.number("SETP1?", temperature, _STEP))
        self.keep(Setting("MRMP1?", ramp, _STEP, "degC/min"), Setting("SETP1?", temperature, _STEP, "degC"))

    @action(effect=Effect.THERMAL, bus_s=2.0)
    def run(self) -> None:
        """Set the chamber running in manual mode and confirm it. Raises: InstrumentError B-INST-019, B-INST-011."""
        self.bring("run")
        self.set("RUNM", either(lambda: self._runs(_MANUAL_RUNS), True))
        if not self.poll(lambda: self._runs(_MANUAL_RUNS), _MODE_LIMIT_S, _MODE_POLL_S):
            raise self.error("B-INST-011", "MODE? does not read back manual run after RUNM", "look at its display")

    @action(effect=Effect.THERMAL, bus_s=2.0)
    def hold(self) -> None:
        """Set the chamber on hold and confirm it: conditions stay, a ramp stands still.

        Raises: InstrumentError B-INST-005, B-INST-011.
        """
        self.set("HOLD", either(self._is_on_hold, True))
        if not self._comes_to_hold():
            raise self.error("B-INST-011", "MODE? does not read back a hold after HOLD", "look at its display")

    @action(effect=Effect.THERMAL, bus_s=2.0)
    def stop(self) -> None:
        """Set heating and cooling off and confirm it; the way out of an over-temperature.

        Raises: InstrumentError B-INST-009.
        """
        self._ready()
        if not self.switch_off("STOP", self._is_stopped):  # refused when it is stopped already: the mode decides
            raise self.error("B-INST-009", "MODE? still reads back a run after STOP", "switch the chamber off")

    @action(returns="degC")
    def measure_air(self) -> float:
        """Measure the air temperature at the controller's own sensor, degC."""
        return self.ask("PVAR1?", read_number)

    def _send(self, command: str) -> None:
        """Send one operation and read its completion (8800) or pause (3800); process alarms raise B-INST-005."""
        if (completion := self._operate(command)) != 0:
            raise self.error("B-INST-005", f"{command!r} was refused with completion {completion}")
        alarms = [alarm for alarm in self.drain_errors() if _PROCESS_ALARM in alarm]
        if alarms:
            raise self.error("B-INST-005", f"after {command!r} the chamber reports: {'; '.join(alarms)}")

    def drain_errors(self) -> list[str]:
        """Get the alarms that stand now; reading does not clear them."""
        standing = self.bus.query("ALRM1?", read_integer, self.timeout_s, repeatable=False)
        return [f"{name} alarm" for bit, name in _ALARMS if standing >> bit & 1]

    def raw(self, command: str, *, answers: bool = False) -> str | None:
        """Control by hand; an operation returns its completion number, 0 of a 3800 where one is due."""
        if "?" in command:
            return super().raw(command)
        self._ready()
        completion = str(self._operate(command))
        return completion if answers or self.options["dialect"] == "8800" else None

    def _operate(self, command: str) -> int:
        if self.options["dialect"] == "8800":
            return self.bus.query(command, read_integer, self.timeout_s, repeatable=False)
        self.bus.write(command, self.timeout_s)
        self.clock.sleep(_PAUSE_3800_S)
        return 0

    def _send_safe(self, command: str) -> None:
        self._operate(command)  # whatever its completion, and whichever alarm stands

    def _mode(self) -> int:
        return self.ask("MODE?", read_integer)

    def _runs(self, how: int = _ANY_RUN) -> bool:
        mode = self._mode()
        return bool(mode & how) and not self._holds(mode)

    def _holds(self, mode: int) -> bool:
        if self.options["dialect"] == "8800":
            return bool(self.ask("STAT?", read_integer) & _HOLDS_8800)
        return bool(mode & _ON_HOLD)

    def _is_on_hold(self) -> bool:
        return self._holds(self._mode())

    def _is_stopped(self) -> bool:
        return self.poll(lambda: not self._mode() & (_ANY_RUN | _ON_HOLD), _MODE_LIMIT_S, _MODE_POLL_S)

    @classmethod
    def wrong_option(cls, options: Mapping[str, Any]) -> tuple[str, str] | None:
        if options["dialect"] not in _DIALECTS:
            return "dialect", f"dialect {options['dialect']!r} is neither '3800' nor '8800'"
        if options["safe_state"] not in ("hold", "stop"):
            return "safe_state", f"safe_state {options['safe_state']!r} is neither hold nor stop"
        return None

    def _identity_of(self, reply: str) -> Identity:
        dialect = str(self.options["dialect"])
        return Identity("THERMOTRON", dialect if dialect in reply else reply, "", reply)

    def _safe_command(self) -> str:
        return "STOP" if self.options["safe_state"] == "stop" else "HOLD"

    def _go_safe(self) -> None:
        if self.options["safe_state"] == "stop":
            self.stop()
        elif self._runs() and not self.switch_off("HOLD", self._comes_to_hold):
            self.bus.note("tx", "<it does not hold: it is stopped>")
            self.stop()

    def _comes_to_hold(self) -> bool:
        return self.poll(self._is_on_hold, _MODE_LIMIT_S, _MODE_POLL_S)


DRIVER = Thermotron3800
