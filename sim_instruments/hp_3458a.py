"""Simulated HP 3458A digital multimeter, in series with the calibrator's output.

Not SCPI. The END line is off at power-on, so a reply then ends by its line feed only. A reading of 100 power-line
cycles with autozero takes 4 s. Direct current alone is connected, and to the front terminals: everything else reads
zero, a resistance an open circuit.

Source: 3458A User's Guide (END, ERRSTR?, INBUF, PRESET, QFORMAT, STB?, DCI ranges and overload; pages 26 power-on, 116
and 194 MATH, 196 MEM, 207 NRDGS, 235 SMATH, 251 TARM, 254 TERM, 257 TRIG); Quick Reference Guide p. 6 (separators,
what is left out, numbers for words); numbers of words as kvez/hp3458a-dcv10-r10-100-gpib, replies.py, has them from an
instrument; commands as the public drivers named in ``instruments/hp_3458a.yaml`` send them. Placeholders: error numbers
beyond the order of the error register's bits; the line's pick-up, drift without autozero, time of ACAL; numbers of the
words of EXTOUT, LEVEL, QFORMAT and SLOPE; the temperature that mathematics for thermometers tell of a current, and the
counts of STAT and PFAIL, which stay 0. Not there: RMEM, which calls readings back.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from bench.model.clock import NS, to_ns
from sim_instruments.bus.live import CommandDevice, CommandError, Reply

NO_ERROR, SYNTAX, UNDEFINED, RANGE = 0, 8, 32, 64  # bits of the error register
ERROR_TEXT = {
    NO_ERROR: '0,"NO ERROR"', SYNTAX: '103,"SYNTAX ERROR"', UNDEFINED: '105,"UNDEFINED PARAMETER RECEIVED"',
    RANGE: '106,"PARAMETER OUT OF RANGE"',
}  # fmt: skip
READY_BIT, ERROR_BIT, SERVICE_BIT, READING_BIT = 16, 32, 64, 128
OVERLOAD = 1e38
ONE_A = ("DCI", 1.0)
LINE_HZ = 50.0
ACAL_S = 165.0
# dc current, 1 year: 95 % of reading and of range; each range has its own shunt, so each draws its own errors
ACCURACY = {
    1e-7: (30e-6, 400e-6), 1e-6: (20e-6, 40e-6), 1e-5: (20e-6, 10e-6), 1e-4: (20e-6, 8e-6),
    1e-3: (20e-6, 5e-6), 1e-2: (20e-6, 5e-6), 1e-1: (35e-6, 5e-6), 1.0: (110e-6, 10e-6),
}  # fmt: skip
LINEARITY_STEPS = 100  # inputs within a hundredth of the range share one linearity error
NOISE_PER_ROOT_CYCLE = 1e-8  # of range, for one power-line cycle
PICK_UP = 1e-3  # of range, at the frequency of the line; whole cycles of it leave nothing
ZERO_DRIFT = 1e-5  # of range, without autozero

# Command | values at power-on | those that stand for what is left out | what each may be: two limits, of whole numbers
# unless there is a point, or words, whose place is the number that stands for them ("-": none does).
TABLE = """
ACBAND  | 20,2E6      | 20,2E6      | 1. 1E7, 1. 1E7
ARANGE  | ON          | ON          | OFF ON ONCE
APER    | 0.2         | 0.          | 0. 1.
AZERO   | ON          | ON          | OFF ON ONCE
BEEP    | ON          | ON          | OFF ON ONCE
DELAY   | 0           | 0           | 0. 6000.
DISP    | ON          | ON          | OFF ON MSG CLR
EMASK   | 32767       | 32767       | 0 32767
END     | OFF         | ALWAYS      | OFF ON ALWAYS
EXTOUT  | ICOMP,NEG   | ICOMP,NEG   | OFF ICOMP ONCE APER BCOMP SRQ RCOMP, NEG POS
FIXEDZ  | OFF         | ON          | OFF ON
FSOURCE | ACV         | ACV         | - - ACV ACDCV - - - ACI ACDCI
FUNC    | DCV,1000    | DCV,1000    | FUNCTION, 0. 1E9
INBUF   | OFF         | ON          | OFF ON
LEVEL   | 0,AC        | 0,AC        | -500. 500., DC AC
LFILTER | OFF         | ON          | OFF ON
LFREQ   | 50          | 50          | 45. 440.
LOCK    | OFF         | ON          | OFF ON
MATH    | OFF,OFF     | OFF,OFF     | OPERATION, OPERATION
MEM     | OFF         | FIFO        | OFF LIFO FIFO CONT
MFORMAT | SREAL       | SREAL       | - ASCII SINT DINT SREAL DREAL
MMATH   | OFF,OFF     | OFF,OFF     | OPERATION, OPERATION
NDIG    | 7           | 7           | 3 8
NPLC    | 10          | 0           | 0. 1000.
NRDGS   | 1,AUTO      | 1,AUTO      | 1 16777215, - AUTO EXT - - SYN TIMER LEVEL LINE
OCOMP   | OFF         | ON          | OFF ON
OFORMAT | ASCII       | ASCII       | - ASCII SINT DINT SREAL DREAL
PRESET  | NORM        | NORM        | FAST NORM DIG
QFORMAT | NORM        | NORM        | NUM NORM ALPHA
RATIO   | OFF         | ON          | OFF ON
RES     | 0           | 0           | 0. 100.
RQS     | 0           | 0           | 0 255
SETACV  | ANA         | ANA         | ANA RNDM SYNC
SLOPE   | POS         | POS         | NEG POS
SSRC    | LEVEL       | LEVEL       | - - EXT - - - - LEVEL
SWEEP   | 1E-7,1024   | 1E-7,1024   | 0. 6000., 1 16777215
TARM    | AUTO        | AUTO        | - AUTO EXT SGL HOLD SYN
TBUFF   | OFF         | ON          | OFF ON
TERM    | FRONT       | FRONT       | OPEN FRONT REAR
TIMER   | 1           | 1           | 0. 6000.
TRIG    | AUTO        | SGL         | - AUTO EXT SGL HOLD SYN - LEVEL LINE
"""
WORDS = {
    "FUNCTION": "- DCV ACV ACDCV OHM OHMF DCI ACI ACDCI FREQ PER DSAC DSDC SSAC SSDC",
    "OPERATION": "OFF CONT - CTHRM DB DBM FILTER - FTHRM NULL PERC PFAIL RMS SCALE STAT - CTHRM2K CTHRM10K FTHRM2K"
    " FTHRM10K CRTD85 CRTD92 FRTD85 FRTD92",
    "REGISTER": "- DEGREE LOWER MAX MEAN MIN NSAMP OFFSET PERC REF RES SCALE SDEV UPPER HIRES PFAILNUM",
}
PRESETS = {  # what one does not name stays as it was
    "NORM": "ACBAND 20,2E6;AZERO ON;BEEP ON;DCV AUTO;DELAY -1;DISP ON;FIXEDZ OFF;FSOURCE ACV;INBUF OFF;LOCK OFF;"
    "MATH OFF;MEM OFF;MFORMAT SREAL;MMATH OFF;NDIG 6;NPLC 1;NRDGS 1,AUTO;OCOMP OFF;OFORMAT ASCII;TARM AUTO;TIMER 1;"
    "TRIG SYN",
    "FAST": "DCV 10;AZERO OFF;DISP OFF;MATH OFF;MFORMAT DINT;OFORMAT DINT;TARM SYN;TRIG AUTO",
    "DIG": "TARM HOLD;TRIG LEVEL;LEVEL 0,AC;TIMER 20E-6;NRDGS 256,TIMER;DCV 10;DELAY 0;APER 3E-6;MFORMAT SINT;"
    "OFORMAT SINT;AZERO OFF;DISP OFF",
}
IGNORED = "CALSTR CSB SCRATCH SRQ TERM TEST TONE"  # the terminals are switched by hand
FIXED = """
AUXERR? 0
CAL? 36.8
CALNUM? 3
CALSTR? ""
LINE? 50.0
MSIZE? 151552,14152
OPT? 0
REV? 9,1
TEMP? 37.2
"""
FORMATS = {"SINT": (">h", 2**15 - 1), "DINT": (">i", 2**31 - 1), "SREAL": (">f", 0), "DREAL": (">d", 0)}
AT_POWER_ON = {"DEGREE": 20.0, "OFFSET": 0.0, "PERC": 1.0, "REF": 1.0, "RES": 50.0, "SCALE": 1.0}
MATHEMATICS: dict[str, Callable[[dict[str, float], float], float]] = {
    "NULL": lambda of, value: value - of["OFFSET"],
    "SCALE": lambda of, value: (value - of["OFFSET"]) / of["SCALE"],
    "PERC": lambda of, value: 100.0 * (value / of["PERC"] - 1.0),
    "DB": lambda of, value: 20.0 * _decades(value / of["REF"]),
    "DBM": lambda of, value: 20.0 * _decades(value) - 10.0 * _decades(of["RES"] * 1e-3),
    "FILTER": lambda of, value: value / of["DEGREE"],  # it was at zero before
    "RMS": lambda of, value: abs(value) / of["DEGREE"] ** 0.5,
}
UNCHANGING, COLD_DEGC = "OFF CONT PFAIL STAT", -273.15  # every other operation tells a temperature
_SEPARATORS = re.compile(r"\s*,\s*|\s+")


def _decades(ratio: float) -> float:
    return math.log10(abs(ratio) or 1e-30)


class Parameter(NamedTuple):
    """A value of a command: a number within limits, or a word, for which its place among the words stands."""

    words: list[str]
    low: float
    high: float
    form: str

    def read(self, text: str) -> Any:
        """Return a number or a word. Raises: CommandError."""
        if text in self.words and text != "-":
            return text
        try:
            value = float(text)
        except ValueError:
            raise CommandError(UNDEFINED) from None
        if not self.low <= value <= self.high:
            raise CommandError(RANGE)
        return self.read(self.words[round(value)]) if self.words else value

    def tell(self, value: Any) -> str:
        """Return a value as a question tells it."""
        return str(self.words.index(value)) if self.words else format(value, self.form)


def parameter(text: str) -> Parameter:
    """Return what a value may be, from words or limits as the table has them."""
    parts = WORDS.get(text.strip(), text).split()
    if parts[-1][0].isalpha():
        return Parameter(parts, 0.0, len(parts) - 1.0, "")
    return Parameter([], float(parts[0]), float(parts[1]), " .8E" if "." in text else ".0f")


def _settings() -> dict[str, list[Any]]:
    rows = (re.split(r"\s*\|\s*", line) for line in TABLE.strip().splitlines())
    return {
        command: [power_on.split(","), left_out.split(","), [parameter(text) for text in limits.split(",")]]
        for command, power_on, left_out, limits in rows
    }


SETTINGS = _settings()
_FIXED = dict(line.split(" ", 1) for line in FIXED.strip().splitlines())
FUNCTION, REGISTER, VALUE = (parameter(text) for text in ("FUNCTION", "REGISTER", "-1E37 1E37"))


def holding(function: str, largest: float) -> float:
    """Return the lowest range that holds an input: 120 % of it, but 105 % of 1 A; infinity if none does."""
    decades = range(-7, 1) if function.endswith("I") else range(1, 10) if "OHM" in function else range(-1, 4)
    ranges = [float(f"1E{decade}") for decade in decades]
    return next((one for one in ranges if largest <= one * (1.05 if (function, one) == ONE_A else 1.2)), math.inf)


class Hp3458A(CommandDevice):
    """DC current meter; the errors of its ranges are drawn once per run, its noise per reading.

    The world's option ``dmm_errors`` set to off leaves the noise alone. ``values``: of each setting, by its command.
    """

    identity = "HP3458A"
    overload = " 1.00000000E+38"
    not_a_number = " NAN"  # it has no such reading; what a damaged one would say

    def power_up(self) -> None:
        super().power_up()
        self._noise = self.world.rng("3458A noise")
        self.values: dict[str, list[Any]] = {"TERM": ["FRONT"]}  # a switch
        self._power_on()

    def _power_on(self) -> None:
        for command, (power_on, *_) in SETTINGS.items():
            if command != "TERM":
                self._set(command, power_on)
        self.registers = dict(AT_POWER_ON)
        self.errors = self._done_ns = 0
        self._armed = self._nulls = False

    def at(self, command: str) -> Any:
        """Return the first value of a setting."""
        return self.values[command][0]

    @property
    def range(self) -> float:
        """Present range, in the unit of the function."""
        return float(self.values["FUNC"][1])

    # --- measuring ---------------------------------------------------------------------------------------------

    @property
    def reading_s(self) -> float:
        """Time of one reading, second."""
        return float(self.at("NPLC") / self.at("LFREQ") * (2 if self.at("AZERO") == "ON" else 1))

    def _measure(self) -> None:
        """Take the readings of one trigger; with the reading memory on none of them is put out."""
        self._armed = False
        readings, event = self.values["NRDGS"]
        if event in ("EXT", "LEVEL"):
            return
        self._go_on(self.at("DELAY"))
        for _ in range(int(readings)):
            self._go_on(self.reading_s)
            value = self._read()
            if self.at("MEM") == "OFF":
                self._put_out(value)

    def _read(self) -> float:
        function = self.at("FUNC")
        true = self.world.wiring.loop_current_A if (function, self.at("TERM")) == ("DCI", "FRONT") else 0.0
        nominal = holding(function, abs(true))
        if self.at("ARANGE") == "ON" and nominal < math.inf:
            self.values["FUNC"][1] = nominal
        noise = self._noise.normal(0.0, NOISE_PER_ROOT_CYCLE / max(self.at("NPLC"), 1e-4) ** 0.5)
        value = true + self.error_A(true) + self.range * (noise + self._disturbance())
        if self._nulls:
            self.registers["OFFSET"], self._nulls = value, False
        for operation in self.values["MATH"]:
            if operation not in UNCHANGING:
                value = MATHEMATICS.get(operation, lambda *_: COLD_DEGC)(self.registers, value)
        if nominal > self.range or "OHM" in function:
            return OVERLOAD if true >= 0 else -OVERLOAD
        return value

    def _disturbance(self) -> float:
        """Return what the drift of zero and the line add to a reading, of range."""
        drift = 0.0 if self.at("AZERO") == "ON" else ZERO_DRIFT
        return drift + PICK_UP * float(np.sinc(self.at("NPLC") * LINE_HZ / self.at("LFREQ")))

    def error_A(self, true_A: float) -> float:
        """Return what the present range adds to a current: its gain, its zero, its linearity; ampere."""
        if self.at("FUNC") != "DCI" or not self.world.options.get("dmm_errors", True):
            return 0.0
        number = list(ACCURACY).index(self.range)
        relative, floor = (half / 2.0 for half in ACCURACY[self.range])
        gain = self.world.rng("3458A gain", number).normal(0.0, relative)
        zero = self.world.rng("3458A zero", number).normal(0.0, floor)
        step = round(abs(true_A) / self.range * LINEARITY_STEPS)
        linearity = self.world.rng("3458A linearity", number, step).normal(0.0, floor) if step else 0.0
        return float(true_A * gain + self.range * (zero + (linearity if true_A > 0 else -linearity)))

    @property
    def held_until_ns(self) -> int:
        """With the input buffer off a triggering command is done when its reading is."""
        return 0 if self.at("INBUF") == "ON" else self._done_ns

    def _go_on(self, seconds: float) -> None:
        """Be at work for so long, behind what is under way."""
        self._done_ns = max(self._done_ns, self.now_ns) + to_ns(seconds)

    def _answer(self, text: str) -> None:
        self.reply(text + "\r", after_s=max(0, self._done_ns - self.now_ns) / NS, end=self.at("END") != "OFF")

    def _put_out(self, value: float) -> None:
        if self.at("OFORMAT") == "ASCII":
            self._answer(self.reading(f"{value: .8E}"))
            return
        form, steps = FORMATS[self.at("OFORMAT")]
        number = round(max(-steps, min(steps, value / self._scale))) if steps else value
        self._replies.append(Reply(struct.pack(form, number), self._done_ns, self.at("END") != "OFF"))

    @property
    def _scale(self) -> float:
        """What one step of an integer stands for."""
        steps = FORMATS.get(self.at("OFORMAT"), ("", 0))[1]
        return 1.2 * self.range / steps if steps else 1.0

    def next_reply(self) -> Any:
        """With the trigger on AUTO or SYN (power-on, PRESET NORM) being addressed to talk takes a reading."""
        is_armed = self._armed or self.at("TARM") in ("AUTO", "SYN")
        if not self._replies and is_armed and self.at("TRIG") in ("AUTO", "SYN"):
            with self.world.lock:
                self._measure()
        return super().next_reply()

    # --- messages ----------------------------------------------------------------------------------------------

    def carry_out(self, command: str) -> None:
        word, *given = _SEPARATORS.split(command.strip().upper())
        name = word.removesuffix("?")
        if not word or word in IGNORED.split():
            return
        if handler := _COMMANDS.get(word):
            handler(self, *given)
        elif word in _ANSWERS:
            self._answer(_ANSWERS[word](self))
        elif word in _FIXED:
            self._answer(_FIXED[word])
        elif word in FUNCTION.words:
            self._select(word, *given)
        elif name not in SETTINGS:
            raise CommandError(SYNTAX)
        elif name != word:
            self._tell(name)
        else:
            self._set(word, given)
            _ACTS.get(word, lambda _: None)(self)

    def _tell(self, name: str) -> None:
        if self.at("QFORMAT") == "ALPHA":
            self._answer(f"{name} {','.join(map(str, self.values[name]))}")
            return
        parts = zip(SETTINGS[name][2], self.values[name], strict=True)
        self._answer(", ".join(one.tell(value) for one, value in parts))

    def _set(self, command: str, given: list[str]) -> None:
        _, left_out, parameters = SETTINGS[command]
        texts = [*given, *left_out[len(given) :]]
        self.values[command] = [
            one.read(default if text in ("", "-1") else text)
            for one, text, default in zip(parameters, texts, left_out, strict=False)
        ]

    def error(self, bit: int) -> None:
        self.errors |= bit

    def status_byte(self) -> int:
        status = READY_BIT if self.now_ns >= self._done_ns else 0
        status |= ERROR_BIT if self.errors & int(self.at("EMASK")) else 0
        status |= READING_BIT if self.reply_ready else 0
        return status | (SERVICE_BIT if status & int(self.at("RQS")) else 0)

    def on_clear(self) -> None:
        self.values |= {"TARM": ["AUTO"], "TRIG": ["HOLD"]}
        self._armed, self._done_ns = False, 0

    def press(self, keys: str) -> None:
        self.values["TERM"] = ["REAR" if self.at("TERM") == "FRONT" else "FRONT"]

    def trigger(self) -> None:
        self._measure()

    def _select(self, function: str = "DCV", largest: str = "", *_: str) -> None:
        """Set function and range; automatic without one. The resolution follows the integration time."""
        function = FUNCTION.read(function)
        automatic = largest in ("", "-1", "AUTO")
        nominal = holding(function, 0.0 if automatic else VALUE.read(largest))
        if nominal == math.inf:
            raise CommandError(RANGE)
        self.values |= {"FUNC": [function, nominal], "ARANGE": ["ON" if automatic else "OFF"]}

    def _start(self) -> None:
        """Measure if arm and trigger have come; a single one of them leaves it on hold."""
        arm, trigger = self.at("TARM"), self.at("TRIG")
        if arm == "SGL":
            self._armed, self.values["TARM"] = True, ["HOLD"]
        if trigger == "SGL":
            self.values["TRIG"] = ["HOLD"]
        if (trigger == "SGL" and arm == "AUTO") or (trigger in ("SGL", "AUTO") and self._armed):
            self._measure()

    def _begin_mathematics(self) -> None:
        self._nulls = "NULL" in self.values["MATH"]

    def _preset(self) -> None:
        for command in PRESETS[self.at("PRESET")].split(";"):
            self.carry_out(command)

    def _set_register(self, name: str = "", text: str = "0", *_: str) -> None:
        self.registers[REGISTER.read(name)] = VALUE.read(text)

    def _next_error(self) -> str:
        lowest = self.errors & -self.errors
        self.errors -= lowest
        return ERROR_TEXT[lowest]


_COMMANDS: dict[str, Callable[..., None]] = {
    "ACAL": lambda self, *_: self._go_on(ACAL_S),
    "FUNC": Hp3458A._select,
    "LFREQ": lambda self, text="LINE", *_: self._set("LFREQ", [text.replace("LINE", str(LINE_HZ))]),
    "RANGE": lambda self, *given: self._select(self.at("FUNC"), *given),
    "RESET": lambda self, *_: self._power_on(),
    "RMATH": lambda self, name="", *_: self._answer(f"{self.registers.get(REGISTER.read(name), 0.0): .8E}"),
    "SMATH": Hp3458A._set_register,
}
_ACTS: dict[str, Callable[[Hp3458A], None]] = {  # what follows when a setting is made
    "APER": lambda self: self.values.update(NPLC=[self.at("APER") * self.at("LFREQ")]),
    "MATH": Hp3458A._begin_mathematics,
    "NPLC": lambda self: self.values.update(APER=[self.at("NPLC") / self.at("LFREQ")]),
    "PRESET": Hp3458A._preset,
    "TARM": Hp3458A._start,
    "TRIG": Hp3458A._start,
}
_ANSWERS: dict[str, Callable[[Hp3458A], str]] = {
    "ERR?": lambda self: self.read_out("errors"),
    "ERRSTR?": Hp3458A._next_error,
    "ID?": lambda self: self.told_identity,
    "ISCALE?": lambda self: f"{self._scale: .8E}",
    "RANGE?": lambda self: f"{self.range: .8E}",
    "STB?": lambda self: str(self.status_byte()),
}

SIMULATOR = Hp3458A
