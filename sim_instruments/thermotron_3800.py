"""Simulated Thermotron chamber controller, dialects "3800" and "8800" (``options["dialect"]``), channel 1 = air.

The 8800 answers every operation with a completion number, 0 = done. The 3800 answers only queries and misses whatever
arrives in the second after an operation. A program, a delayed start and a calibration are begun at the front panel, as
are degF and the limits of the alarm.

Source: Thermotron 8800 interface command descriptions (ALRM, reply 0 to operations); mode bits as published for the
3800; a public class for the 8800 (MODE, STAT, CCHR, OPTN; MRMP per minute in the scale of the controller).
Placeholders, not confirmed on hardware: that MODE tells a hold, reply of IDEN?, completion numbers of refusals,
set-point range, deviation band of the alarm, the speed without a ramp, what the air does with product temperature
control (it goes beyond) and with guaranteed soak (it waits).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, ClassVar

from bench.model.clock import NS
from sim_instruments.bus.live import LiveDevice
from sim_instruments.faults.fault import Fault, NamedFaults, plain_number

PAUSE_NS = NS
LOW_DEGC, HIGH_DEGC = -70.0, 180.0
FASTEST_DEGC_MIN = 5.0
PROGRAM_RUN, EDIT_STOP, EDIT_HOLD, MANUAL_RUN, DELAYED_START, CALIBRATION = 1, 2, 8, 16, 32, 128
_STATUS = {PROGRAM_RUN: 1, PROGRAM_RUN | EDIT_HOLD: 2, MANUAL_RUN: 16, MANUAL_RUN | EDIT_HOLD: 32}  # of STAT?, by mode
PRODUCT_CONTROL, GUARANTEED_SOAK = 1, 8
PROGRAM_DEGC, BEYOND_DEGC = 85.0, 10.0
CELSIUS, FAHRENHEIT = ("C", 1.0, 0.0), ("F", 1.8, 32.0)
_KEYS = {
    "RUN PROGRAM": ("mode", PROGRAM_RUN), "DELAYED START": ("mode", EDIT_STOP | DELAYED_START),
    "CALIBRATION": ("mode", CALIBRATION), "DEGF": ("scale", FAHRENHEIT),
    "HIGH LIMIT 20": ("high_degC", 20.0), "LOW LIMIT 60": ("low_degC", 60.0),
}  # fmt: skip
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
        self.mode, self.controls = EDIT_STOP, 0
        self.scale, self.low_degC, self.high_degC = CELSIUS, LOW_DEGC, HIGH_DEGC
        self.setpoint_degC, self.rate_degC_min = 23.0, 0.0
        self._deaf_until_ns = -1
        self._runaway_degC_min = self._shortfall_degC = 0.0
        rng = self.world.rng("chamber sensor offset")
        self._offset_degC = rng.normal(0.0, SENSOR_OFFSET_SIGMA_DEGC)

    def leave(self, setting: str) -> None:
        for one in setting.split(";"):
            super().leave(one)
            self._deaf_until_ns = -1  # somebody took the time

    def press(self, keys: str) -> None:
        attribute, value = _KEYS[keys]
        setattr(self, attribute, value)
        if self.mode == PROGRAM_RUN:
            self.world.thermal.ramp(PROGRAM_DEGC, FASTEST_DEGC_MIN, self.now_ns)

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
            "IDEN": lambda: self.told_identity,
            "PVAR1": lambda: self.reading(self._shown(self._air_degC())),
            "SETP1": lambda: self._shown(self.setpoint_degC),
            "MRMP1": lambda: f"{self.rate_degC_min * self.scale[1]:.1f}",
            "MODE": lambda: str(self.mode),
            "ALRM1": lambda: str(self._alarms()),
        }
        if (answer := answers.get(word + channel)) is not None:
            self.reply(answer())
        elif self.dialect == "8800":
            only = {"STAT": _STATUS.get(self.mode, 0), "CCHR1": self.scale[0], "OPTN": self.controls}
            self.reply(str(only.get(word + channel, UNKNOWN)))

    def _air_degC(self) -> float:
        return float(self.world.thermal.air_degC(self.now_ns)) + self._offset_degC

    def _shown(self, value_degC: float) -> str:
        _, factor, zero = self.scale
        return f"{value_degC * factor + zero:.1f}"

    def _alarms(self) -> int:
        air_degC = self._air_degC()
        return (LOW_PROCESS if air_degC < self.low_degC else 0) | (HIGH_PROCESS if air_degC > self.high_degC else 0)

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
        start_degC = thermal.setpoint_degC(now_ns)
        short_degC = self._shortfall_degC if self.setpoint_degC > start_degC else -self._shortfall_degC
        beyond_degC = BEYOND_DEGC if self.controls & PRODUCT_CONTROL else 0.0
        target_degC = self.setpoint_degC + beyond_degC - short_degC
        thermal.ramp(target_degC, self.rate_degC_min or FASTEST_DEGC_MIN, now_ns)
        if self.controls & GUARANTEED_SOAK:
            thermal.hold(now_ns)

    def _set(self, attribute: str, low: float, high: float, channel: str, text: str) -> int:
        _, factor, zero = self.scale
        value = (round(plain_number(text), 1) - (zero if attribute == "setpoint_degC" else 0.0)) / factor
        if channel != "1" or not low <= value <= high:
            return BAD_VALUE
        setattr(self, attribute, value)
        if self.mode == MANUAL_RUN:
            self._apply()
        return DONE

    def _run(self, *_: str) -> int:
        if self.mode & (PROGRAM_RUN | DELAYED_START | CALIBRATION):
            return NOT_NOW
        self.mode = MANUAL_RUN
        self._apply()
        return DONE

    def _hold(self, *_: str) -> int:
        if self.mode not in (MANUAL_RUN, PROGRAM_RUN):
            return NOT_NOW
        self.mode |= EDIT_HOLD
        if not self._runaway_degC_min:
            self.world.thermal.hold(self.now_ns)
        return DONE

    def _resume(self, *_: str) -> int:
        return self._run() if self.mode == MANUAL_RUN | EDIT_HOLD else NOT_NOW

    def _stop(self, *_: str) -> int:
        if self.mode == EDIT_STOP:
            return NOT_NOW
        self.mode = EDIT_STOP
        self.world.thermal.stop(self.now_ns)
        return DONE

    def _control(self, number: str, _: str) -> int:
        if self.dialect != "8800":
            return UNKNOWN
        self.controls = int(number or 0)
        return DONE


_OPERATIONS: dict[str, Callable[[Thermotron3800, str, str], int]] = {
    "SETP": lambda self, *given: self._set("setpoint_degC", LOW_DEGC, HIGH_DEGC, *given),
    "MRMP": lambda self, *given: self._set("rate_degC_min", 0.0, 20.0, *given),
    "RUNM": Thermotron3800._run,
    "RESM": Thermotron3800._resume,
    "HOLD": Thermotron3800._hold,
    "STOP": Thermotron3800._stop,
    "OPTN": Thermotron3800._control,
    "INIT": lambda self, *_: DONE,
}

SIMULATOR = Thermotron3800
