"""Counter and lock-in amplifier of the strange rack."""

from __future__ import annotations

import math
import re
from typing import ClassVar

from rack_base import Rack, Refused, Row, Table, number
from rack_meters import NEVER_S, ScpiMeter


class Agilent53230A(ScpiMeter):
    """Agilent 53230A (Programmer's Reference, its *RST table). *RST leaves ROSC:SOUR:AUTO alone: it is kept."""

    identity = "Agilent Technologies,53230A,MY50000001,02.05-1519.666-1.19-4.15-127-157-35"
    rows = (
        *ScpiMeter.rows,
        Row("", "func", "raw", "FREQ", ("PER", "TOT")),
        Row("[SENSe:]FREQuency:GATE:TIME", "gate", "num", 0.1, (1e-3, 10.0)),
        Row("[SENSe:]FREQuency:GATE:SOURce", "gate_source", "TIME|EXTernal", "TIME", ("EXT",), "gate"),
        Row("INPut[1]:LEVel:AUTO", "level_auto", "bool", True, (False,), "level"),
        Row("INPut[1]:LEVel[:ABSolute]", "level", "num", 0.0, (2.5, -2.0), "level"),
        Row("CALCulate[1]:STATe", "math", "bool", False, (True,), "math|CALC"),
        Row("FORMat[:DATA]", "format", "ASCii|REAL", "ASC", ("REAL",), "FORM:|data format"),
        Row("[SENSe:]ROSCillator:SOURce", "reference", "INTernal|EXTernal", "INT", ("EXT",)),
        Row("[SENSe:]ROSCillator:SOURce:AUTO", "reference_auto", "bool", True, (False,), "reference", False),
        Row("[SENSe:]ROSCillator:EXTernal:FREQuency", "reference_Hz", "num", 10e6, (5e6,), "reference"),
        Row("", "unplugged", "bool", False, (True,), "reference|oscillator", False),
    )
    asks: ClassVar[Table] = ScpiMeter.asks | {
        "[SENSe:]FUNCtion[:ON]": lambda unit, a: f'"{unit.state["func"]}"',
        "STATus:QUEStionable[:EVENt]": lambda unit, a: "+0",
    }
    tells: ClassVar[Table] = ScpiMeter.tells | {
        "[SENSe:]FUNCtion[:ON]": lambda unit, a: unit.state.update(func=re.split(r'[" ]', a[0])[1].upper())
    }
    truth_Hz = 43210.987

    def changed(self, key: str) -> None:
        if key == "reference":
            self.state["reference_auto"] = False
            if self.state["reference"] == "EXT" and self.state["unplugged"]:
                self.state["reference"] = "INT"
                raise Refused('+293,"External reference oscillator not valid"')

    @property
    def is_external(self) -> bool:
        state = self.state
        is_wanted = state["reference_auto"] or state["reference"] == "EXT"
        return bool(is_wanted and state["reference_Hz"] == 10e6 and not state["unplugged"])

    def values(self) -> tuple[list[str], float]:
        state, value = self.state, self.truth_Hz * (1.0 if self.is_external else 1.0 + 2e-6)
        is_counted = (state["level_auto"] or abs(state["level"]) < 1.0) and state["gate_source"] == "TIME"
        value = (value if state["func"] == "FREQ" else 1.0 / value) * (2.0 if state["math"] else 1.0)
        text = f"{value:+.15E}" if state["format"] == "ASC" else "#18????????"
        return [text], state["gate"] + state["delay"] if is_counted else NEVER_S


class Sr830(Rack):
    """SRS SR830 (manual, chapter 5), with 0.2 V at 10 kHz at A, 30 deg behind the reference, and nothing at B.

    No error queue: *ESR? bit 5 tells a wrong command, 4 a wrong value. OUTX 0 sends every reply to the serial port.
    """

    identity, is_tree = "Stanford_Research_Systems,SR830,s/n00111,ver1.07", False
    rows = (
        Row("OUTX", "port", "int", 1, (0,), "OUTX|serial port", False),
        Row("PHAS", "phase", "num", 0.0, (90.0, -45.0)), Row("FREQ", "Hz", "num", 1000.0, (50.0,)),
        Row("FMOD", "internal", "int", 0, (1,)), Row("RSLP", "slope_in", "int", 0, (1, 2)),
        Row("HARM", "harmonic", "int", 1, (2, 3)), Row("ISRC", "source", "int", 0, (1, 2, 3)),
        Row("IGND", "ground", "int", 0, (1,)), Row("ICPL", "coupling", "int", 0, (1,)),
        Row("ILIN", "notches", "int", 0, (3,)), Row("RMOD", "reserve", "int", 1, (0, 2)),
        Row("SENS", "sens", "int", 26, (5, 20)), Row("OFLT", "tau", "int", 10, (2, 19)),
        Row("OFSL", "slope", "int", 1, (0, 3)), Row("SYNC", "sync", "int", 0, (1,)),
        Row("", "offset 1", "num", 0.0, (10.0, -50.0)), Row("", "offset 2", "num", 0.0, (5.0,)),
        Row("", "expand", "int", 0, (1, 2)),
        Row("", "unlocked", "bool", False, (True,), "", False), Row("", "old_bits", "int", 0, (1, 8, 12, 4), "", False),
    )  # fmt: skip
    asks: ClassVar[Table] = {
        "*IDN": Rack.asks["*IDN"], "ERRS": lambda unit, a: "0", "SNAP": lambda unit, a: unit.snap(a),
        "LIAS": lambda unit, a: unit.latched("bits", a), "*ESR": lambda unit, a: unit.latched("event", a),
        "OEXP": lambda unit, a: f"{unit.state.get('offset ' + a[0], 0.0):.2f},{unit.state['expand']}",
    }  # fmt: skip
    tells: ClassVar[Table] = {
        "OEXP": lambda unit, a: unit.state.update({f"offset {a[0]}": number(a[1]), "expand": int(a[2])}),
    }

    def legal(self) -> None:
        self.event, self.errors, self.bits = 32 * bool(self.errors), [], self.state["old_bits"]

    def fault(self, entry: str) -> None:
        self.event |= 32 if entry.startswith("-1") else 16

    def do(self, command: str) -> str | None:
        return super().do(re.sub(r"^(\*?[A-Z]{3,4}\??)\s*", r"\1 ", command))

    def reply(self, row: Row, arguments: list[str]) -> str:
        value = self.state[row.key]
        return f"{(value + 180.0) % 360.0 - 180.0:.2f}" if row.key == "phase" else str(value)

    def read(self) -> str:
        self.output = self.output if self.state["port"] else None
        return super().read()

    def full_V(self) -> float:
        return float((1.0, 2.0, 5.0)[(self.state["sens"] + 1) % 3] * 10.0 ** ((self.state["sens"] + 1) // 3 - 9))

    def now_bits(self) -> int:
        is_over = self.full_V() < 0.2 / 1.1 and self.state["source"] < 2
        return 4 * is_over + 8 * (self.state["unlocked"] and not self.state["internal"])

    def latched(self, name: str, arguments: list[str]) -> str:
        bits = getattr(self, name) | (self.now_bits() if name == "bits" else 0)
        setattr(self, name, 0)
        return str(bits >> int(arguments[0]) & 1 if arguments else bits)

    def snap(self, arguments: list[str]) -> str:
        state = self.state
        is_seen = not state["internal"] and state["harmonic"] == 1 and state["source"] == 0 and not state["unlocked"]
        angle = math.radians(-30.0 - state["phase"] + 180.0 * (state["slope_in"] == 2))
        x_V, y_V = (0.2 * is_seen * part - self.full_V() * state[f"offset {n}"] / 100.0
                    for n, part in enumerate((math.cos(angle), math.sin(angle)), 1))  # fmt: skip
        values = {"1": x_V, "2": y_V, "9": state["Hz"] if state["internal"] else 10e3 * (not state["unlocked"])}
        return ",".join(f"{values[which]:.6g}" for which in arguments)
