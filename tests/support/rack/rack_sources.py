"""Sources of the strange rack: calibrator, waveform generator, supplies, switch."""

from __future__ import annotations

import math
import re
from typing import Any, ClassVar

from rack_base import NUMBER, Rack, Refused, Row, Table, number

from bench.model.clock import to_ns


class Fluke5720A(Rack):
    """Fluke 5720A (5700A/5720A Series II Operators Manual, chapter 5; status bits: page 5-51).

    Its current is the set-point, times SCALE, plus OFFSET, at the posts that CUR_POST names, or at the amplifier's with
    BOOST; OUT without 0 HZ leaves alternating current as it is. Open: whether OUT? includes the offset, the words of
    RANGELCK?, whether a change of function goes to standby or ends a phase lock, and the numbers of faults.
    """

    identity = "FLUKE,5720A,4105001,1.6+A+*"
    no_error, unknown, unread, unasked, overflow, depth, is_tree = "0", "1301", "1304", "1305", "1308", 16, False
    texts: ClassVar = {"1301": "Unknown command", "1306": "Value exceeds entry limits", "1307": "Range is locked"}
    asks: ClassVar[Table] = {
        "*IDN": Rack.asks["*IDN"], "FAULT": lambda unit, a: unit.next_error(), "ISR": lambda unit, a: unit.status(),
        "EXPLAIN": lambda unit, a: f'"{unit.texts.get(a[0], "Fault")}"', "OUT": lambda unit, a: unit.told(),
        "LIMIT": lambda unit, a: f"1.1E+03,-1.1E+03,{unit.state.limit_A:.4E},{-unit.state.limit_A:.4E}",
    }  # fmt: skip
    tells: ClassVar[Table] = Rack.tells | {
        "OUT": lambda unit, a: unit.out(a), "OPER": lambda unit, a: unit.switch(True),
        "STBY": lambda unit, a: unit.switch(False),
        "LIMIT": lambda unit, a: unit.state.update(limit_A=number(a[0])) if a[0].upper().endswith("A") else None,
    }  # fmt: skip
    steps_A, settled_ns = (2.2e-4, 2.2e-3, 2.2e-2, 0.22, 2.2), 0

    def legal(self) -> None:
        state, self.errors = self.state, ["1301"] * len(self.errors)
        state.update(boost=state.boost and state.unit == "A", wideband=state.wideband and state.unit == "V")
        if state.unit == "OHM":
            state.update(amount=1e4, frequency_Hz=0.0, lock=False)

    def effective_A(self) -> float:
        step_A = self.state.range_A / 2.2e6
        return float(round((self.state.amount * self.state.scale + self.state.offset) / step_A) * step_A)

    @property
    def current_A(self) -> float:
        """The direct current at the normal posts."""
        state = self.state
        is_on = state.output and state.unit == "A" and not state.frequency_Hz
        is_here = is_on and not state.boost and state.post == "NORMAL"
        return self.effective_A() + state.edit_A if is_here else 0.0

    def told(self) -> str:
        state = self.state
        amount = self.effective_A() if self.open[0] and state.unit == "A" else state.amount
        return f"{amount:.7E},{state.unit},{state.frequency_Hz:.7E}"

    def switch(self, is_on: bool) -> None:
        self.state.output, self.settled_ns = is_on, self.clock.now_ns() + to_ns(self.draw.uniform(0.5, 6.0))

    def out(self, arguments: list[str]) -> None:
        for found in map(NUMBER.match, arguments):
            if found is None or found[2].upper() not in ("A", "MA", "UA", "HZ"):
                raise Refused("1302")
            if found[2].upper() == "HZ":
                self.state.frequency_Hz = float(found[1])
            else:
                self.put(float(found[1]) * {"A": 1.0, "MA": 1e-3, "UA": 1e-6}[found[2].upper()])
        self.switch(self.state.output)

    def put(self, amount_A: float) -> None:
        state = self.state
        if amount_A > state.limit_A:
            raise Refused("1306")
        if state.unit != "A":
            state.phase_lock &= self.open[3]
            state.update(unit="A", lock=False, wideband=False, output=state.output and self.open[1])
        if amount_A > (state.range_A if state.lock else 2.2):
            raise Refused("1307")
        if not state.lock:
            state.range_A = next(step_A for step_A in self.steps_A if amount_A <= step_A)
        state.update(amount=amount_A, edit_A=0.0)

    def status(self) -> str:
        state, is_settled = self.state, self.clock.now_ns() >= self.settled_ns
        flags = (state.output, state.guard, state.sense, state.boost, False, state.lock, False,
                 state.phase_lock, state.offset != 0.0, state.scale != 1.0, state.wideband, True,
                 is_settled)  # fmt: skip
        return str(sum(flag << bit for bit, flag in enumerate(flags)))

    def reply(self, row: Row, arguments: list[str]) -> str:
        words = ("OFF", "ON") if self.open[2] else ("0", "1")
        return words[self.state[row.key]] if row.domain == "bool" else super().reply(row, arguments)


class Agilent33250A(Rack):
    """Agilent 33250A (User's Guide, chapter 4). VOLT counts in VOLT:UNIT into OUTP:LOAD, behind 50 ohm."""

    identity = "Agilent Technologies,33250A,0,2.01-1.01-2.00-03-1"
    modes = ("am", "fm", "fsk", "sweep", "burst")

    def legal(self) -> None:
        state, on = self.state, [mode for mode in self.modes if self.state[mode]]
        state |= dict.fromkeys(on if state.shape == "DC" else on[1:], False)
        if state.unit == "DBM":
            state.update({"unit": "VPP"} if state.load > 1e6 else {"amplitude": -10.0})
        state.Hz = min(state.Hz, {"RAMP": 1e6, "PULS": 50e6}.get(state.shape, 80e6))
        state.duty = 50.0 if state.Hz > 25e6 else state.duty
        self.held_V = math.inf if state.auto else 1.5 * self.peak_V()

    def gain(self) -> float:
        """Of the open output over that into the load it counts on."""
        return float(1.0 if self.state.load > 1e6 else 1.0 + 50.0 / self.state.load)

    def pp_V(self, amount: float | None = None) -> float:
        """Peak to peak at the open output."""
        state = self.state
        amount = state.amplitude if amount is None else amount
        crest = {"SIN": 2.0 * math.sqrt(2.0), "RAMP": 2.0 * math.sqrt(3.0)}.get(state.shape, 2.0)
        if state.unit == "DBM":
            return math.sqrt(1e-3 * 10.0 ** (amount / 10.0) * state.load) * crest * self.gain()
        return float(amount * (crest if state.unit == "VRMS" else 1.0) * self.gain())

    def peak_V(self) -> float:
        return float(self.pp_V() / 2.0 + abs(self.state.offset) * self.gain())

    def set(self, row: Row, arguments: list[str]) -> None:
        state, pp_V, offset_V = self.state, self.pp_V(), self.state.offset * self.gain()
        if row.key == "unit" and arguments[0] == "DBM" and state.load > 1e6:
            raise Refused('-221,"Settings conflict; not able to set dBm units while load impedance is infinite"')
        super().set(row, [arguments[0].replace("INFINITY", "INF").replace("INF", "9.9E37"), *arguments[1:]])
        if row.key == "load" and state.load > 1e6 and state.unit == "DBM":
            state.unit = "VPP"
        if row.key in ("load", "unit"):  # what is at the terminals stays
            amplitude = -10.0 if state.unit == "DBM" else pp_V / self.pp_V(1.0)
            state.update(offset=offset_V / self.gain(), amplitude=amplitude)

    def changed(self, key: str) -> None:
        state = self.state
        if key in self.modes and state[key]:
            state |= {mode: mode == key for mode in self.modes}
        self.held_V = math.inf if state.auto else self.held_V
        is_level, top_Hz = key in ("amplitude", "offset"), {"RAMP": 1e6, "PULS": 50e6}.get(state.shape, 80e6)
        if is_level and self.peak_V() > self.held_V:
            raise Refused('-222,"Data out of range; value clipped to upper limit"')
        if is_level and self.peak_V() > 10.0 + 1e-9:
            state.offset = max(10.0 - self.pp_V() / 2.0, 0.0) / self.gain()
            raise Refused('-221,"Settings conflict; offset changed because of amplitude"')
        room = 0.0 if state.Hz > 50e6 else 10.0 if state.Hz > 25e6 else 30.0
        if key in ("Hz", "duty", "shape") and state.shape == "SQU" and abs(state.duty - 50.0) > room:
            state.duty = 50.0 + math.copysign(room, state.duty - 50.0)
            raise Refused('-221,"Settings conflict; duty cycle changed because of frequency"')
        if key in ("Hz", "shape") and state.Hz > top_Hz:
            raise Refused('-221,"Settings conflict; frequency too high for this function"')

    def shows(self) -> dict[str, Any]:
        """What is at the open output."""
        state, wave = self.state, {key: self.state[key] for key in ("output", "shape", "Hz", "duty", "polarity")}
        volts = {"Vpp": round(self.pp_V(), 6), "offset": round(state.offset * self.gain(), 6)}
        return wave | volts | {"modes": [mode for mode in self.modes if state[mode]]}


class Hp6632B(Rack):
    """HP 6632B (programming guide of the 66312A, 663xB and 661xC), with 20 ohm at its output.

    A measurement takes SENS:SWE:POIN times TINT; more than the low range of 20 mA reads as 9.91E37. COMP: the commands
    of the 6632A, until SYST:LANG SCPI.
    """

    identity = "HEWLETT-PACKARD,6632B,US00000001,A.00.01"
    asks: ClassVar[Table] = Rack.asks | {
        "MEASure:VOLTage[:DC]": lambda unit, a: unit.measured(unit.out_V()),
        "MEASure:CURRent[:DC]": lambda unit, a: unit.measured(unit.out_V() / 20.0, unit.state.range),
        "STATus:QUEStionable[:CONDition]": lambda unit, a: unit.questionable(),
    }
    tells: ClassVar[Table] = Rack.tells | {
        "ABORt": lambda unit, a: None,
        "OUTPut:PROTection:CLEar": lambda unit, a: (unit.state.update(tripped=""), unit.changed(""))[1],
    }
    peak_V = 0.0

    def take(self, text: str) -> None:
        if self.state.language == "COMP" and text in ("OUT 0", "OUT 1"):
            self.state.output = text == "OUT 1"
        super().take(text)

    def legal(self) -> None:
        self.state.inhibited &= self.state.ri != "OFF"
        super().legal()
        self.state.language = "SCPI" if self.draw.random() < 0.8 else self.state.language

    def out_V(self) -> float:
        state = self.state
        is_on = state.output and not state.tripped and not state.inhibited
        return float(min(state.V, state.A * 20.0) if is_on else 0.0)

    def changed(self, key: str) -> None:
        state, self.peak_V = self.state, max(self.peak_V, self.out_V())
        if self.out_V() > state.over_V:
            state.tripped = "OV"
        elif self.out_V() and state.over_current and state.V > state.A * 20.0:
            state.tripped = "OC"

    def measured(self, value: float, most: float = math.inf) -> str:
        return self.after(self.state.points * self.state.interval, f"{value if value <= most else 9.91e37:.6E}")

    def questionable(self) -> str:
        return str({"": 0, "OV": 1, "OC": 2}[self.state.tripped] + 512 * self.state.inhibited)


class AgilentE3631A(Rack):
    """Agilent E3631A (User's Guide E3631-90002, chapter 4), with 100 ohm at each rail; rails 2 and 3 may track."""

    identity = "HEWLETT-PACKARD,E3631A,0,2.1-5.0-1.0"
    rails: ClassVar = {"P6V": (0.0, 6.18, 5.15), "P25V": (0.0, 25.75, 1.03), "N25V": (-25.75, 0.0, 1.03)}
    asks: ClassVar[Table] = Rack.asks | {
        "INSTrument[:SELect]": lambda unit, a: unit.state.rail,
        "INSTrument:NSELect": lambda unit, a: str(1 + list(unit.rails).index(unit.state.rail)),
        "VOLTage": lambda unit, a: f"{unit.state['V_' + unit.state.rail]:+.8E}",
        "CURRent": lambda unit, a: f"{unit.state['A_' + unit.state.rail]:+.8E}",
        "MEASure:VOLTage[:DC]": lambda unit, a: unit.after(0.1, f"{unit.out_V(a[0] if a else unit.state.rail):+.8E}"),
    }
    tells: ClassVar[Table] = Rack.tells | {
        "INSTrument[:SELect]": lambda unit, a: unit.state.update(rail=a[0].upper()),
        "INSTrument:NSELect": lambda unit, a: unit.state.update(rail=list(unit.rails)[int(a[0]) - 1]),
        "VOLTage": lambda unit, a: unit.put("V", number(a[0])), "CURRent": lambda unit, a: unit.put("A", number(a[0])),
    }  # fmt: skip

    def changed(self, key: str) -> None:
        if self.state.track:
            self.state.V_N25V = -self.state.V_P25V

    def out_V(self, rail: str) -> float:
        most_V = self.state[f"A_{rail}"] * 100.0
        return float(max(-most_V, min(most_V, self.state[f"V_{rail}"])) if self.state.output else 0.0)

    def put(self, kind: str, value: float) -> None:
        rail = self.state.rail
        low, high, most_A = self.rails[rail]
        if not (low <= value <= high if kind == "V" else 0.0 <= value <= most_A):
            raise Refused('-222,"Data out of range"')
        self.state[f"{kind}_{rail}"] = value
        if kind == "V" and self.state.track and rail != "P6V":
            self.state |= {"V_P25V": abs(value), "V_N25V": -abs(value)}


class Keithley7002(Rack):
    """Keithley 7002 (instruction manual, SCPI command reference) with 7012 matrix cards in all slots.

    A channel pair closes together, a forbidden channel is refused, a scan that runs goes on through its list; ABOR
    begins it again under INIT:CONT. Open: the text of the refusal.
    """

    identity = "KEITHLEY INSTRUMENTS INC.,MODEL 7002,0700001,B03  /A02"
    no_error = '0,"No error"'
    asks: ClassVar[Table] = Rack.asks | {
        "[ROUTe]:CLOSe:STATe": lambda unit, a: f"(@{','.join(sorted(unit.now()))})",
        "[ROUTe]:CLOSe": lambda unit, a: ",".join(str(int(point in unit.now())) for point in unit.points(a[0])),
        "[ROUTe]:CONFigure:CPAir": lambda unit, a: f"(@{unit.state.pair})",
        "[ROUTe]:FCHannels": lambda unit, a: f"(@{unit.state.forbidden})",
    }
    tells: ClassVar[Table] = Rack.tells | {
        "[ROUTe]:CLOSe": lambda unit, a: unit.close_points(unit.points(a[0])),
        "[ROUTe]:OPEN": lambda unit, a: unit.open_points(a[0]),
        "[ROUTe]:OPEN:ALL": lambda unit, a: unit.open_points("ALL"),
        "[ROUTe]:CONFigure:CPAir": lambda unit, a: unit.state.update(pair=""),
        "[ROUTe]:FCHannels": lambda unit, a: unit.state.update(forbidden=""),
        "ABORt": lambda unit, a: unit.state.update(scanning=unit.state.continuous),
    }

    def legal(self) -> None:
        self.closed = set(filter(None, self.state.closed.split(",")))
        self.state.forbidden *= self.state.forbidden not in self.closed
        super().legal()

    def now(self) -> set[str]:
        """The crosspoints that are closed by now."""
        if self.state.scanning:
            self.closed = {f"1!1!{1 + self.clock.now_ns() // to_ns(0.4) % 10}"}
        return self.closed

    @property
    def is_energised(self) -> bool:
        return bool(self.now())

    def points(self, text: str) -> list[str]:
        points = text.replace(" ", "").removeprefix("(@").removesuffix(")").split(",")
        if not all(re.fullmatch(r"(\d|10)![1-4]!(\d|10)", point) for point in points):
            raise Refused('-101,"Invalid character"')
        return points

    def open_points(self, text: str) -> None:
        self.now().difference_update(self.closed.copy() if text.upper() == "ALL" else self.points(text))

    def close_points(self, points: list[str]) -> None:
        self.now()
        for point in points:
            if point == self.state.forbidden:
                raise Refused('+513,"Forbidden channel"' if self.open[0] else '-221,"Settings conflict"')
            if self.state.single:
                self.closed.clear()
            pair = self.state.pair.split(",")
            self.closed.update(pair if point in pair else [point])
        self.after(0.01 + self.state.settle_s, "")

    def changed(self, key: str) -> None:
        self.state.scanning |= self.state.continuous
        if key == "*RST":
            self.closed.clear()
