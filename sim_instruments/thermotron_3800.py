"""Simulated Thermotron chamber controller, dialects "3800" and "8800" (``options["dialect"]``), channel 1 = air.

The 8800 answers every operation with a completion number, 0 = done. The 3800 answers only queries and misses whatever
arrives in the second after an operation.

Source: Thermotron 8800 interface command descriptions (ALRM, reply 0 to operations); mode bits as published for the
3800. Placeholders, not confirmed on hardware: MRMP in degC/min, HOLD, reply of IDEN?, completion numbers of refusals,
set-point range, deviation band of the alarm, the speed without a ramp.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from bench.model.clock import NS
from sim_instruments.bus.live import LiveDevice
from sim_instruments.faults.fault import Fault, NamedFaults, plain_number

PAUSE_NS = NS
LOW_DEGC, HIGH_DEGC = -70.0, 180.0
FASTEST_DEGC_MIN = 5.0
PROGRAM_RUN, MANUAL_RUN, EDIT_STOP, EDIT_HOLD = 1, 16, 2, 8
LOW_PROCESS, HIGH_PROCESS = 16, 32
DONE, UNKNOWN, NOT_NOW, BAD_VALUE = 0, 1, 2, 5
SENSOR_OFFSET_SIGMA_DEGC = 0.1
_MESSAGE = re.compile(r"([A-Z]{4})(\d?)(\?|,.*)?")


class Thermotron3800(LiveDevice):
    """Chamber in manual mode: a set-point approached with a ramp; its own sensor has an offset drawn once."""

    def power_up(self) -> None:
        super().power_up()
        self.dialect = str(self.options.get("dialect", "3800"))
        self.identity = f"{self.dialect} PROGRAMMER CONTROLLER V1.2"
        self.mode = EDIT_STOP
        self.setpoint_degC, self.rate_degC_min = 23.0, 0.0
        self._deaf_until_ns = -1
        self._runaway_degC_min = self._shortfall_degC = 0.0
        rng = self.world.rng("chamber sensor offset")
        self._offset_degC = rng.normal(0.0, SENSOR_OFFSET_SIGMA_DEGC)

    def leave_more(self, draw: np.random.Generator) -> None:
        self.setpoint_degC = round(draw.uniform(LOW_DEGC, HIGH_DEGC), 1)
        self.rate_degC_min = round(draw.uniform(0.0, 20.0), 1)
        self.mode = int(draw.choice([EDIT_STOP, MANUAL_RUN, MANUAL_RUN | EDIT_HOLD, PROGRAM_RUN]))
        if self.mode in (MANUAL_RUN, PROGRAM_RUN):
            self._apply()

    def execute(self, message: str) -> None:
        if self.now_ns < self._deaf_until_ns:
            return
        match = _MESSAGE.fullmatch(message.strip().upper())
        word, channel, rest = match.groups() if match else ("", "", "")
        if rest == "?":
            self._query(word, channel)
            return
        operation = _OPERATIONS.get(word)
        completion = UNKNOWN if operation is None else operation(self, channel, (rest or "").lstrip(","))
        if self.dialect == "8800":
            self.reply(str(completion))
        else:
            self._deaf_until_ns = self.now_ns + PAUSE_NS

    def _query(self, word: str, channel: str) -> None:
        answers = {
            ("IDEN", ""): lambda: self.told_identity,
            ("PVAR", "1"): lambda: self.reading(f"{self._air_degC():.1f}"),
            ("SETP", "1"): lambda: f"{self.setpoint_degC:.1f}",
            ("MRMP", "1"): lambda: f"{self.rate_degC_min:.1f}",
            ("MODE", ""): lambda: str(self.mode),
            ("ALRM", "1"): lambda: str(self._alarms()),
        }
        answer = answers.get((word, channel))
        if answer is not None:
            self.reply(answer())
        elif self.dialect == "8800":
            self.reply(str(UNKNOWN))

    def _air_degC(self) -> float:
        return float(self.world.thermal.air_degC(self.now_ns)) + self._offset_degC

    def _alarms(self) -> int:
        air_degC = self._air_degC()
        return (LOW_PROCESS if air_degC < LOW_DEGC else 0) | (HIGH_PROCESS if air_degC > HIGH_DEGC else 0)

    def run_away(self, rate_degC_min: float = 0.0) -> None:
        """Fault: a running chamber follows no set-point but rises at that rate; STOP ends it, HOLD does not."""
        self._runaway_degC_min = rate_degC_min
        self._fault_changed()

    def fall_short(self, shortfall_degC: float = 0.0) -> None:
        """Fault: the chamber stops that far from each set-point it is sent from now on, so it never settles."""
        self._shortfall_degC = shortfall_degC
        self._fault_changed()

    named_faults: ClassVar[NamedFaults] = {
        "chamber_runaway": Fault(
            "chamber", (("RATE", -20.0, 20.0),),
            "a running chamber leaves its set-point, degC/min; only STOP ends it", run_away, run_away),
        "chamber_shortfall": Fault(
            "chamber", (("DEGC", -50.0, 50.0),),
            "the chamber stays that far from its set-point and never settles", fall_short, fall_short),
    }  # fmt: skip

    def _fault_changed(self) -> None:
        """Go on with what the chamber does now, with that fault."""
        if self.mode == MANUAL_RUN or (self.mode & MANUAL_RUN and self._runaway_degC_min):
            self._apply()
        elif self.mode & MANUAL_RUN:
            self.world.thermal.hold(self.now_ns)

    def outputs(self) -> dict[str, Any]:
        words = {PROGRAM_RUN: "running", MANUAL_RUN: "running", MANUAL_RUN | EDIT_HOLD: "holding"}
        return {"mode": words.get(self.mode, "stopped"), "setpoint_degC": self.setpoint_degC}

    def _apply(self) -> None:
        """Send the chamber to its set-point, short of it by the fault's shortfall; a runaway knows no set-point."""
        thermal, now_ns = self.world.thermal, self.now_ns
        if runaway_degC_min := self._runaway_degC_min:
            thermal.run_away(runaway_degC_min, now_ns)
            return
        rate_degC_min = self.rate_degC_min or FASTEST_DEGC_MIN
        start_degC = thermal.setpoint_degC(now_ns)
        short_degC = self._shortfall_degC if self.setpoint_degC > start_degC else -self._shortfall_degC
        thermal.ramp(self.setpoint_degC - short_degC, rate_degC_min, now_ns)

    def _set(self, attribute: str, low: float, high: float, channel: str, text: str) -> int:
        value = plain_number(text)
        if channel != "1" or not low <= value <= high:
            return BAD_VALUE
        setattr(self, attribute, round(value, 1))
        if self.mode == MANUAL_RUN:
            self._apply()
        return DONE

    def _run(self, _: str, __: str) -> int:
        if self.mode == PROGRAM_RUN:
            return NOT_NOW
        self.mode = MANUAL_RUN
        self._apply()
        return DONE

    def _hold(self, _: str, __: str) -> int:
        if self.mode != MANUAL_RUN:
            return NOT_NOW
        self.mode = MANUAL_RUN | EDIT_HOLD
        if not self._runaway_degC_min:
            self.world.thermal.hold(self.now_ns)
        return DONE

    def _resume(self, _: str, __: str) -> int:
        return self._run("", "") if self.mode == MANUAL_RUN | EDIT_HOLD else NOT_NOW

    def _stop(self, _: str, __: str) -> int:
        if self.mode == EDIT_STOP:
            return NOT_NOW
        self.mode = EDIT_STOP
        self.world.thermal.stop(self.now_ns)
        return DONE


_OPERATIONS: dict[str, Callable[[Thermotron3800, str, str], int]] = {
    "SETP": lambda self, *given: self._set("setpoint_degC", LOW_DEGC, HIGH_DEGC, *given),
    "MRMP": lambda self, *given: self._set("rate_degC_min", 0.0, 20.0, *given),
    "RUNM": Thermotron3800._run,
    "RESM": Thermotron3800._resume,
    "HOLD": Thermotron3800._hold,
    "STOP": Thermotron3800._stop,
    "INIT": lambda self, _, __: DONE,
}

SIMULATOR = Thermotron3800
