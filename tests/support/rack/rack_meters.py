"""Meters of the strange rack."""

from __future__ import annotations

import math
import re
from typing import Any, ClassVar

from rack_base import Rack, Refused, Row, State, Table, number

from bench.model.clock import to_ns

NEVER_S = 1e9


class Hp3458A(Rack):
    """HP 3458A (User's Guide 03458-90014, command reference and power-on state), at ranges of direct current.

    Open: whether PRESET sets QFORMAT; whether a reading nobody took outlasts the next command; whether CR LF behind a
    trigger holds the bus with INBUF OFF until the reading is done, as its quick reference (page 6) says of commands.
    """

    identity, end, is_tree = "HP3458A", "\r\n", False
    asks: ClassVar[Table] = {
        "ID": lambda unit, a: unit.identity, "ERR": lambda unit, a: unit.take_errors(True),
        "ERRSTR": lambda unit, a: unit.take_errors(False), "AUXERR": lambda unit, a: " 0",
        "TERM": lambda unit, a: unit.header("TERM") + {"front": " 1", "rear": " 2"}[unit.state.terminals],
    }  # fmt: skip
    tells: ClassVar[Table] = {
        "DCI": lambda unit, a: unit.span(a, "DCI"), "RANGE": lambda unit, a: unit.span(a, unit.state.func),
        "PRESET": lambda unit, a: unit.preset("SYN", 1.0), "RESET": lambda unit, a: unit.preset("AUTO", 10.0),
        "LFREQ": lambda unit, a: unit.state.update(lfreq=50.01 if a[0] == "LINE" else number(a[0])),
        "NRDGS": lambda unit, a: unit.state.update(nrdgs=number(a[0]), event=a[1] if a[1:] else "AUTO"),
    }  # fmt: skip
    truth_A = 0.0

    def legal(self) -> None:
        self.burst_ns: list[int] = []
        self.memory = [0.123456]
        self.bits = 0b1001 if self.errors else 0
        self.output = self.output and " 1.23456789E-03"

    def reading_s(self) -> float:
        state = self.state
        return float((1 + (state.azero == "ON")) * state.nplc / 50.0 + max(state.delay, 0.0) + 0.01)

    def reading(self) -> float:
        state = self.state
        if state.func != "DCI":
            return 0.071
        full_A = state.range if state.arange == "OFF" else 1.0
        true_A = self.truth_A if state.terminals == "front" else 0.0
        if abs(true_A) > full_A * (1.05 if full_A == 1.0 else 1.2):
            return 1e38
        value = true_A + full_A * (2e-4 * (state.azero == "OFF") + 1e-6 / state.nplc + 1e-5 * (state.lfreq > 55.0))
        return float({"NULL": value - 3e-4, "SCALE": (value - 1e-4) / 3.0, "FILTER": value * 0.7,
                      "DB": 20.0 * math.log10(abs(value) + 1e-12)}.get(state.math, value))  # fmt: skip

    def changed(self, key: str) -> None:
        state = self.state
        if key in ("trig", "tarm"):  # arm, trigger and sample event let readings begin
            self.burst_ns = []
            if (state.tarm, state.trig) in (("AUTO", "SGL"), ("SGL", "AUTO")):
                count = int(state.nrdgs) if state.event == "AUTO" else 0
                self.burst_ns = [self.clock.now_ns() + to_ns(self.reading_s()) * (n + 1) for n in range(count)]
                state[key] = "HOLD"
        self.memory = [] if key == "mem" and state.mem != "OFF" else self.memory

    def supply(self) -> None:
        """Have a reading for a controller that asks for one: of the memory, of the trigger, or as they come."""
        state, now_ns = self.state, self.clock.now_ns()
        if state.mem != "OFF":
            done = [due_ns for due_ns in self.burst_ns if due_ns <= now_ns]
            self.memory, self.burst_ns = self.memory + [self.reading()] * len(done), self.burst_ns[len(done) :]
            if not self.memory:
                return
            value, self.ready_ns = self.memory.pop(0 if state.mem == "FIFO" else -1), now_ns
        elif self.burst_ns:
            value, self.ready_ns = self.reading(), self.burst_ns.pop(0)
        elif {state.tarm, state.trig} <= {"AUTO", "SYN", "LINE"}:
            value, self.ready_ns = self.reading(), now_ns + to_ns(self.reading_s())
        else:
            return
        self.output = f"{value: .9E}" if state.oformat == "ASCII" else "?\x03A"

    def read(self) -> str:
        if self.output is None:
            self.supply()
        if self.output is None or (self.state.eoi == "OFF" and not (self.read_termination or "").endswith("\n")):
            raise self.time_out()
        return super().read()

    def read_stb(self) -> int:
        now_ns = self.clock.now_ns()
        has_burst = self.state.mem == "OFF" and any(due_ns <= now_ns for due_ns in self.burst_ns[:1])
        is_error = self.bits & int(self.state.emask)
        return (super().read_stb() & 16 or has_burst) and 128 | 16 * (not self.burst_ns) | 32 * bool(is_error)

    def clear(self) -> None:
        super().clear()
        self.burst_ns = []

    def write(self, message: str) -> int:
        kept, self.output = (self.output, self.ready_ns) if self.open[0] and "?" not in message else None, None
        length = super().write(message)
        if kept is not None and self.output is None:
            self.output, self.ready_ns = kept
        is_held = self.open[1] and self.state.inbuf == "OFF" and self.write_termination == "\r\n"
        if is_held and self.burst_ns and "SGL" in message:
            if self.burst_ns[-1] - self.clock.now_ns() > to_ns(self.timeout / 1000.0):
                raise self.time_out()
            self.clock.sleep_until_ns(self.burst_ns[-1])
        return length

    def do(self, command: str) -> str | None:
        return super().do(re.sub(r"\s*,\s*|\s+", ",", command).replace(",", " ", 1).upper())

    def fault(self, entry: str) -> None:
        self.bits |= {"-113": 8, "-109": 128, "-222": 64, "-410": 0, "-420": 0}.get(entry[:4], 32)

    def header(self, name: str) -> str:
        return f"{name} " if self.state.qformat == "ALPHA" else ""

    def take_errors(self, is_all: bool) -> str:
        bits, lowest = self.bits, self.bits & -self.bits
        self.bits = 0 if is_all else bits & ~lowest
        one = f'{100 + lowest.bit_length()},"ERROR"' if bits else '0,"NO ERROR"'
        return f"{self.header('ERR')} {bits}" if is_all else one

    def preset(self, trig: str, nplc: float) -> None:
        qformat = self.state.qformat if self.open[2] and trig == "SYN" else "NORM"
        self.state |= {row.key: row.preset for row in self.rows if row.reset}
        self.state.update(trig=trig, nplc=nplc, qformat=qformat)
        self.burst_ns = []

    def span(self, arguments: list[str], func: str) -> None:
        """The lowest range that holds a highest input; without one, automatic."""
        most = number(arguments[0]) if arguments and arguments[0] != "AUTO" else -1.0
        if most > 1.2 or (func != "DCI" and most > 0.0):
            raise Refused('-222,"Parameter out of range"')
        step = next(10.0**n for n in range(-7, 1) if most <= 10.0**n * 1.2 * (1.0 + 1e-9))
        self.state.update(func=func, arange="ON" if most < 0.0 else "OFF", range=step)

    def words(self, row: Row) -> dict[str, str]:
        return dict(pair.split("=") for pair in row.domain.split("|") if "=" in pair)

    def value(self, row: Row, text: str) -> Any:
        words = self.words(row)
        if row.domain != "num" and text not in words and text not in words.values():
            raise Refused('-224,"Undefined parameter"')
        return number(text) if row.domain == "num" else next((name for name in words if text == words[name]), text)

    def reply(self, row: Row, arguments: list[str]) -> str:
        value = self.state[row.key]
        if row.domain == "num":
            return self.header(row.header) + f"{value: .9E}"
        return self.header(row.header) + (value if self.header("") else f" {self.words(row)[value]}")


class ScpiMeter(Rack):
    """What the SCPI meters share: READ? waits for its triggers and takes its time; it begins from idle alone."""

    asks: ClassVar[Table] = Rack.asks | {"READ": lambda unit, a: unit.read_values()}
    tells: ClassVar[Table] = Rack.tells | {"ABORt": lambda unit, a: unit.state.update(running=False)}

    def values(self) -> tuple[list[str], float]:
        """The values of one sample, and the time they take, second."""
        raise NotImplementedError

    def read_values(self) -> str:
        state, (values, each_s) = self.state, self.values()
        if state.running:
            raise Refused('-213,"Init ignored"')
        if state.trigger == "BUS":
            raise Refused('-214,"Trigger deadlock"')
        count = int(state.triggers * state.samples)
        wait_s = NEVER_S if state.trigger == "EXT" else min(each_s * count, NEVER_S)
        return self.after(wait_s, ",".join(values * min(count, 20)))

    def clear(self) -> None:
        super().clear()
        self.state.running = False


class Agilent34401A(ScpiMeter):
    """HP/Agilent 34401A (User's Guide 34401-90004, chapter 4; the table of what CONFigure presets).

    The interface menu of its front panel may leave it another language; SCPI has no answer then.
    """

    identity, error_bit = "HEWLETT-PACKARD,34401A,0,11-5-2", 0
    asks: ClassVar[Table] = ScpiMeter.asks | {"ROUTe:TERMinals": lambda unit, a: unit.state.terminals}
    tells: ClassVar[Table] = ScpiMeter.tells | {
        "CONFigure[:VOLTage][:DC]": lambda unit, a: unit.configure("VOLT", a),
        "CONFigure:FRESistance": lambda unit, a: unit.configure("FRES", a),
    }

    def legal(self) -> None:
        self.state.language = "SCPI" if self.draw.random() < 0.9 else self.state.language

    def configure(self, func: str, arguments: list[str]) -> None:
        self.state.update(trigger="IMM", triggers=1.0, samples=1.0, delay=0.0, math=False, azero=True, running=False)
        self.state |= {"func": func, "range": number(arguments[0]) if arguments else 0.0, f"nplc_{func}": 10.0}

    def values(self) -> tuple[list[str], float]:
        state = self.state
        value = {"VOLT": 3.21, "FRES": 787.0}.get(state.func, 1e-5) * (1.0 if state.azero else 1.001)
        if state.terminals == "REAR":
            value = 9.9e37 if state.func == "FRES" else 2e-4
        elif state.range and value > 1.2 * state.range:
            value = 9.9e37
        if state.math and value < 1e37:
            value = {"NULL": value - 1.5, "DB": 20.0 * math.log10(value)}.get(state.math_kind, value)
        return [f"{value:+.8E}"], state.get(f"nplc_{state.func}", 10.0) / 25.0 + state.delay


class Agilent34970A(ScpiMeter):
    """Agilent 34970A (User's Guide 34970-90003, chapters 4 and 5). What a user left is so on every channel.

    CONFigure loses the previous configuration of a channel, sets gain 1 and offset 0, and turns the fields beside a
    reading off; *RST leaves autozero alone (page 105). Open: which command is refused when the internal meter is off,
    whether *RST has it on again, whether CONFigure enables autozero, and whether it selects degC.
    """

    identity = "HEWLETT-PACKARD,34970A,0,13-2-2"
    fields: ClassVar = {"UNIT": " C", "TIME": ",0000123.4", "CHANnel": ",101", "ALARm": ",0"}
    tells: ClassVar[Table] = ScpiMeter.tells | {
        "ROUTe:SCAN": lambda unit, a: unit.state.update(scan=unit.listed(a)),
        "CONFigure:TEMPerature": lambda unit, a: unit.configure(unit.listed(a), "TEMP", couple=a[1].upper()),
        "CONFigure:FRESistance": lambda unit, a: unit.configure(unit.listed(a), "FRES", range=number(a[0])),
    }
    truth: ClassVar = {101: 21.5, 102: -40.25, 103: 787.0}

    def legal(self) -> None:
        keys = [row.key for row in self.rows]
        self.own = self.rows[keys.index("func") : keys.index("wait") + 1]
        self.channels: dict[int, State] = {}

    def of(self, channel: int) -> State:
        return self.channels.setdefault(channel, State({row.key: self.state[row.key] for row in self.own}))

    def listed(self, arguments: list[str]) -> tuple[int, ...]:
        if not arguments or not arguments[-1].startswith("(@"):
            return tuple(self.state.scan)
        return tuple(int(part) for part in arguments.pop()[2:-1].split(",") if part.strip())

    def set(self, row: Row, arguments: list[str]) -> None:
        channels = self.listed(arguments) if row in self.own else ()
        for channel in channels:
            self.of(channel)[row.key] = self.value(row, arguments[0])
        if not channels:
            super().set(row, arguments)

    def reply(self, row: Row, arguments: list[str]) -> str:
        states = [self.of(channel) for channel in (self.listed(arguments) if row in self.own else ())]
        return ",".join(self.shown(row, state[row.key]) for state in states or [self.state])

    def configure(self, channels: tuple[int, ...], func: str, **settings: Any) -> None:
        if not self.state.dmm and self.open[0]:
            raise Refused('305,"Not able to perform requested operation"')
        self.state |= {"scan": channels, "trigger": "IMM", "triggers": 1.0} | dict.fromkeys(self.fields, False)
        for channel in channels:
            azero, unit = self.of(channel).azero or func == "FRES" or self.open[2], self.of(channel).unit
            settings |= {"func": func, "azero": azero, "unit": "C" if self.open[3] else unit}
            self.channels[channel] = State({row.key: row.preset for row in self.own} | settings)

    def changed(self, key: str) -> None:
        if key == "*RST":
            self.channels.clear()
            self.state.dmm |= self.open[1]

    def values(self) -> tuple[list[str], float]:
        if not self.state.scan or not self.state.dmm:
            raise Refused('305,"Not able to perform requested operation"')
        each_s = sum(self.of(channel).nplc / 25.0 + 0.02 + self.of(channel).wait for channel in self.state.scan)
        is_timed = self.state.trigger == "TIM" and self.state.triggers > 1.0
        return [self.told(channel) for channel in sorted(self.state.scan)], max(each_s, self.state.timer * is_timed)

    def told(self, channel: int) -> str:
        own, value = self.of(channel), self.truth.get(channel, 0.0)
        if own.func == "TEMP":
            value += {"INT": 0.0, "EXT": -5.0, "FIX": -23.0}[own.junction]
            value += {"T": 0.0, "J": -9.0, "K": 4.0, "E": -14.0}[own.couple]
            value = {"C": value, "F": value * 1.8 + 32.0, "K": value + 273.15}[own.unit]
        elif own.func != "FRES":
            value = 1e-3
        elif own.range and value > 1.2 * own.range:
            value = 9.9e37
        value += 0.01 * (not own.azero)
        value = value * own.gain + own.offset if own.scaled else value
        return f"{value:+.8E}" + "".join(text for name, text in self.fields.items() if self.state[name])


class Agilent53230A(ScpiMeter):
    """Agilent 53230A (Programmer's Reference, its *RST table). *RST leaves ROSC:SOUR:AUTO alone: it is kept."""

    identity = "Agilent Technologies,53230A,MY50000001,02.05-1519.666-1.19-4.15-127-157-35"
    asks: ClassVar[Table] = ScpiMeter.asks | {
        "[SENSe:]FUNCtion[:ON]": lambda unit, a: f'"{unit.state.func}"',
        "STATus:QUEStionable[:EVENt]": lambda unit, a: "+0",
    }
    tells: ClassVar[Table] = ScpiMeter.tells | {
        "[SENSe:]FUNCtion[:ON]": lambda unit, a: unit.state.update(func=re.split(r'[" ]', a[0])[1].upper())
    }
    truth_Hz = 43210.987

    def changed(self, key: str) -> None:
        if key == "reference":
            self.state.reference_auto = False
            if self.state.reference == "EXT" and self.state.unplugged:
                self.state.reference = "INT"
                raise Refused('+293,"External reference oscillator not valid"')

    @property
    def is_external(self) -> bool:
        state = self.state
        is_wanted = state.reference_auto or state.reference == "EXT"
        return bool(is_wanted and state.reference_Hz == 10e6 and not state.unplugged)

    def values(self) -> tuple[list[str], float]:
        state, value = self.state, self.truth_Hz * (1.0 if self.is_external else 1.0 + 2e-6)
        is_counted = (state.level_auto or abs(state.level) < 1.0) and state.gate_source == "TIME"
        value = (value if state.func == "FREQ" else 1.0 / value) * (2.0 if state.math else 1.0)
        text = f"{value:+.15E}" if state.format == "ASC" else "#18????????"
        return [text], state.gate + state.delay if is_counted else NEVER_S


class Sr830(Rack):
    """SRS SR830 (manual, chapter 5), with 0.2 V at 10 kHz at A, 30 deg behind the reference, and nothing at B.

    No error queue: *ESR? bit 5 tells a wrong command, 4 a wrong value. OUTX 0 sends every reply to the serial port.
    """

    identity, is_tree = "Stanford_Research_Systems,SR830,s/n00111,ver1.07", False
    asks: ClassVar[Table] = {
        "*IDN": Rack.asks["*IDN"], "ERRS": lambda unit, a: "0", "SNAP": lambda unit, a: unit.snap(a),
        "LIAS": lambda unit, a: unit.latched("bits", a), "*ESR": lambda unit, a: unit.latched("event", a),
        "OEXP": lambda unit, a: f"{unit.state.get('offset_' + a[0], 0.0):.2f},{unit.state.expand}",
    }  # fmt: skip
    tells: ClassVar[Table] = {
        "OEXP": lambda unit, a: unit.state.update({f"offset_{a[0]}": number(a[1]), "expand": int(a[2])}),
    }

    def legal(self) -> None:
        self.event, self.errors, self.bits = 32 * bool(self.errors), [], self.state.old_bits

    def fault(self, entry: str) -> None:
        self.event |= 32 if entry.startswith("-1") else 16

    def do(self, command: str) -> str | None:
        return super().do(re.sub(r"^(\*?[A-Z]{3,4}\??)\s*", r"\1 ", command))

    def reply(self, row: Row, arguments: list[str]) -> str:
        value = self.state[row.key]
        return f"{(value + 180.0) % 360.0 - 180.0:.2f}" if row.key == "phase" else str(value)

    def read(self) -> str:
        self.output = self.output if self.state.port else None
        return super().read()

    def full_V(self) -> float:
        return float((1.0, 2.0, 5.0)[(self.state.sens + 1) % 3] * 10.0 ** ((self.state.sens + 1) // 3 - 9))

    def now_bits(self) -> int:
        is_over = self.full_V() < 0.2 / 1.1 and self.state.source < 2
        return 4 * is_over + 8 * (self.state.unlocked and not self.state.internal)

    def latched(self, name: str, arguments: list[str]) -> str:
        bits = getattr(self, name) | (self.now_bits() if name == "bits" else 0)
        setattr(self, name, 0)
        return str(bits >> int(arguments[0]) & 1 if arguments else bits)

    def snap(self, arguments: list[str]) -> str:
        state = self.state
        is_seen = not state.internal and state.harmonic == 1 and state.source == 0 and not state.unlocked
        angle = math.radians(-30.0 - state.phase + 180.0 * (state.slope_in == 2))
        x_V, y_V = (0.2 * is_seen * part - self.full_V() * state[f"offset_{n}"] / 100.0
                    for n, part in enumerate((math.cos(angle), math.sin(angle)), 1))  # fmt: skip
        values = {"1": x_V, "2": y_V, "9": state.Hz if state.internal else 10e3 * (not state.unlocked)}
        return ",".join(f"{values[which]:.6g}" for which in arguments)
