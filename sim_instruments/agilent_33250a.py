"""Simulated Agilent 33250A function generator; the output of the first one goes to the unit's
function-generator input.

Source: 33250A User's Guide (remote interface; ranges of square waves, load and amplitude; burst, sweep and modulation
end each other; VRMS and DBM, which needs a load; 166: a pulse ends before the next one begins); specifications (what
can be swept, modulated, given in bursts). The unit's input has a high impedance: with the load setting at 50 ohm its
amplitude is twice the programmed one. Placeholders: the error of an amplitude without autorange; a pulse that does not
fit is refused, where the real one shortens it and tells so.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, ClassVar

from sim_instruments.bus.scpi import (
    OUT_OF_RANGE,
    SETTINGS_CONFLICT,
    Answers,
    Handlers,
    ScpiDevice,
    ScpiError,
    command,
    words,
)

FREQUENCY_ERROR_PPM = 3.0
UNIT_THRESHOLD_VPP = 0.5  # smaller signals are not counted by the unit
INFINITE_OHM = 9.9e37
BURST_HZ, SWEEP_HZ, FSK_HZ = 100.0, 550.0, 100.0  # after *RST: trigger period, mean of 100 Hz to 1 kHz, hop
_MODULATED = 0.99  # cycles of a modulated square that the unit's threshold counts
_EDGES = 1.6  # edge times between the end of a pulse and the next one
_HELD_RANGE = 1.02
_MODES = {"BURS": "BURSt", "SWE": "SWEep", "AM": "AM", "FM": "FM", "FSK": "FSKey"}
_CREST = {"SIN": 2.0 * math.sqrt(2.0), "SQU": 2.0, "PULS": 2.0, "RAMP": 2.0 * math.sqrt(3.0)}  # peak to peak over RMS
_NOT_IN = {"BURS": ("DC",), **dict.fromkeys(("SWE", "AM", "FM", "FSK"), ("DC", "NOIS", "PULS"))}  # functions by mode
_HIGHEST_HZ = {"USER": 25e6, "SIN": 80e6, "SQU": 80e6, "RAMP": 1e6, "PULS": 50e6, "NOIS": 80e6, "DC": 80e6}


class Agilent33250A(ScpiDevice):
    """Function generator; its frequency error is drawn once, uniform within 3 ppm."""

    identity = "Agilent Technologies,33250A,SIM33250,1.05-1.01-1.00-03-1"
    answers: ClassVar[Answers] = {
        "[:SOURce]:VOLTage?": lambda self: f"{self._in_unit(self.amplitude_V, self.amplitude_unit):+.13E}",
        "[:SOURce]:VOLTage:HIGH?": lambda self: f"{self.offset_V + self.amplitude_V / 2.0:+.13E}",
        "[:SOURce]:VOLTage:LOW?": lambda self: f"{self.offset_V - self.amplitude_V / 2.0:+.13E}",
        "[:SOURce]:PULSe:PERiod?": lambda self: f"{1.0 / self.frequency_Hz:+.13E}",
        **{
            f"[:SOURce]:{node}:STATe?": lambda self, mode=mode: str(int(self.mode == mode))
            for mode, node in _MODES.items()
        },
    }
    settings = """
:OUTPut:POLarity                 | polarity       | NORM | NORMal, INVerted
:OUTPut[:STATe]                  | on!            | OFF
:OUTPut:LOAD?                    | load_ohm       | 50.
[:SOURce]:VOLTage:RANGe:AUTO     | autorange!     | ON
[:SOURce]:VOLTage:UNIT?          | amplitude_unit | VPP
[:SOURce]:VOLTage:OFFSet         | offset_V       | 0.   | _lowest_V _room_V V
[:SOURce]:FREQuency              | frequency_Hz!  | 1E3  | by _read_frequency
[:SOURce]:FUNCtion[:SHAPe]?      | function       | SIN
[:SOURce]:FUNCtion:SQUare:DCYCle | duty_percent   | 50.  | by _read_duty
[:SOURce]:PULSe:WIDTh            | width_s        | 1E-4 | 8E-9 _longest_s s
[:SOURce]:PULSe:TRANsition       | edge_s         | 5E-9 | 5E-9 1E-3 s
:OUTPut:SYNC[:STATe]             |                | ON
:OUTPut:TRIGger[:STATe]          |                | OFF
:OUTPut:TRIGger:SLOPe            |                | POS  | POSitive, NEGative
[:SOURce]:BURSt:MODE             |                | TRIG | TRIGgered, GATed
[:SOURce]:BURSt:NCYCles          |                | 1.   | 1 1E6 INF
[:SOURce]:BURSt:INTernal:PERiod  |                | 0.01 | 1E-6 500 S
[:SOURce]:BURSt:PHASe            |                | 0.   | -360 360
[:SOURce]:BURSt:GATE:POLarity    |                | NORM | NORMal, INVerted
[:SOURce]:PHASe                  |                | 0.   | -360 360
[:SOURce]:FUNCtion:RAMP:SYMMetry |                | 100. | 0 100
:TRIGger:SOURce                  |                | IMM  | IMMediate, EXTernal, BUS
:TRIGger:SLOPe                   |                | POS  | POSitive, NEGative
:TRIGger:DELay                   |                | 0.   | 0 85 S
:SYSTem:BEEPer[:IMMediate]       |                |      |  | -
"""

    def power_up(self) -> None:
        draw = self.rng("function generator frequency")
        self.error_ppm = draw.uniform(-FREQUENCY_ERROR_PPM, FREQUENCY_ERROR_PPM)
        super().power_up()

    def reset(self) -> None:
        self.amplitude_V, self.mode = 0.1, ""
        self._apply()

    @property
    def true_frequency_Hz(self) -> float:
        """Pulses per second at the output terminal, hertz; 0 when it is off or not periodic.

        A burst is one cycle at a time, by its internal trigger; a sweep and keyed frequencies have their mean.
        """
        if not self.on or self.function in ("DC", "NOIS"):
            return 0.0
        if self.mode in _MODES:
            return {"BURS": BURST_HZ, "SWE": SWEEP_HZ, "FSK": (self.frequency_Hz + FSK_HZ) / 2.0}.get(
                self.mode, self.frequency_Hz * _MODULATED
            )
        return self.frequency_Hz * (1.0 + self.error_ppm * 1e-6)

    @property
    def open_amplitude_V(self) -> float:
        """Peak-to-peak amplitude at a high-impedance input, volt."""
        return self.amplitude_V / self._share * (1.0 if self.autorange else _HELD_RANGE)

    @property
    def _share(self) -> float:
        """Part of an open output's amplitude that its load setting says is at the load."""
        return 1.0 if self.load_ohm == INFINITE_OHM else self.load_ohm / (self.load_ohm + 50.0)

    @property
    def _lowest_V(self) -> float:
        return -self._room_V

    @property
    def _longest_s(self) -> float:
        return 1.0 / self.frequency_Hz - _EDGES * self.edge_s

    def _read_frequency(self, text: str) -> float:
        return round(self.number(text, 1e-6, _HIGHEST_HZ[self.function], "Hz"), 6)

    def _read_duty(self, text: str) -> float:
        return self.number(text, 50.0 - self._duty_room, 50.0 + self._duty_room)

    @property
    def _duty_room(self) -> float:
        """How far a duty cycle may be from 50 %, at most."""
        return 30.0 if self.frequency_Hz <= 25e6 else 10.0 if self.frequency_Hz <= 50e6 else 0.0

    def _apply(self) -> None:
        """Put out what is set, but for a duty cycle that the frequency has not: it is reduced and told."""
        off_50 = self.duty_percent - 50.0
        if self.function == "SQU" and abs(off_50) > self._duty_room:
            self.duty_percent = 50.0 + math.copysign(self._duty_room, off_50)
            self.error(*SETTINGS_CONFLICT)
        counted = self.open_amplitude_V >= UNIT_THRESHOLD_VPP
        if self.is_first:
            self.world.unit.set_fg(self.true_frequency_Hz if counted else 0.0, self.now_ns)

    def outputs(self) -> dict[str, Any]:
        return {"on": self.on, "frequency_Hz": self.frequency_Hz, "amplitude_V": self.amplitude_V}

    @property
    def _largest_V(self) -> float:
        return 20.0 * self._share

    @property
    def _room_V(self) -> float:
        return (self._largest_V - self.amplitude_V) / 2

    @command("[:SOURce]:FUNCtion[:SHAPe]")
    def _set_function(self, text: str) -> None:
        function = self.word(text, "SINusoid", "SQUare", "RAMP", "PULSe", "NOISe", "DC", "USER")
        if self.frequency_Hz > _HIGHEST_HZ[function]:
            self.frequency_Hz = _HIGHEST_HZ[function]
            self.error(*SETTINGS_CONFLICT)
        if function in _NOT_IN.get(self.mode, ()):
            self.mode = ""
            self.error(*SETTINGS_CONFLICT)
        self.function = function
        self._apply()

    @command("[:SOURce]:PULSe:PERiod")
    def _set_period(self, text: str) -> None:
        self.frequency_Hz = 1.0 / self.number(text, max(20e-9, self.width_s + _EDGES * self.edge_s), 2000.0, "s")
        self._apply()

    @command("[:SOURce]:VOLTage")
    def _set_amplitude(self, text: str) -> None:
        unit = next((unit for unit in ("VPP", "VRMS", "DBM") if text.upper().endswith(unit)), self.amplitude_unit)
        bounds = (self._in_unit(bound_V, unit) for bound_V in (self._largest_V / 1000.0, self._largest_V))
        amplitude_V = self._from_unit(self.number(text.upper().removesuffix(unit), *bounds, "V"), unit)
        if amplitude_V / 2 + abs(self.offset_V) > self._largest_V / 2:
            raise ScpiError(*SETTINGS_CONFLICT)
        self.amplitude_V = round(amplitude_V, 4)
        self._apply()

    def _in_unit(self, peak_to_peak_V: float, unit: str) -> float:
        """Return an amplitude in VPP, VRMS or DBM (of the power in the load)."""
        if unit == "VPP":
            return peak_to_peak_V
        rms_V = peak_to_peak_V / self._crest
        return rms_V if unit == "VRMS" else 10.0 * math.log10(rms_V**2 / self._finite_load_ohm() / 1e-3)

    def _from_unit(self, value: float, unit: str) -> float:
        if unit == "DBM":
            value = math.sqrt(10.0 ** (value / 10.0) * 1e-3 * self._finite_load_ohm())
        return value if unit == "VPP" else value * self._crest

    @property
    def _crest(self) -> float:
        return _CREST.get(self.function, _CREST["SIN"])

    def _finite_load_ohm(self) -> float:
        if self.load_ohm == INFINITE_OHM:
            raise ScpiError(*SETTINGS_CONFLICT)  # no power goes into it
        return self.load_ohm

    @command("[:SOURce]:VOLTage:HIGH")
    def _set_high(self, text: str) -> None:
        self._between(self.offset_V - self.amplitude_V / 2.0, self.number(text, -10.0, 10.0, "V"))

    @command("[:SOURce]:VOLTage:LOW")
    def _set_low(self, text: str) -> None:
        self._between(self.number(text, -10.0, 10.0, "V"), self.offset_V + self.amplitude_V / 2.0)

    def _between(self, low_V: float, high_V: float) -> None:
        largest_V = self._largest_V
        if not largest_V / 1000.0 <= high_V - low_V or max(abs(low_V), abs(high_V)) > largest_V / 2.0:
            raise ScpiError(*SETTINGS_CONFLICT)
        self.amplitude_V, self.offset_V = round(high_V - low_V, 4), (high_V + low_V) / 2.0
        self._apply()

    def further(self) -> Handlers:
        return {f"[:SOURce]:{node}:STATe": partial(self._switch_mode, mode) for mode, node in _MODES.items()}

    def _switch_mode(self, mode: str, text: str) -> None:
        """One of burst, sweep and modulation at a time: each that is switched on ends the one before."""
        if self.boolean(text):
            if self.function in _NOT_IN[mode]:
                raise ScpiError(*SETTINGS_CONFLICT)
            self.mode = mode
        elif self.mode == mode:
            self.mode = ""
        self._apply()

    @command("[:SOURce]:VOLTage:UNIT")
    def _set_unit(self, text: str) -> None:
        unit = self.word(text, "VPP", "VRMS", "DBM")
        if unit == "DBM":
            self._finite_load_ohm()
        self.amplitude_unit = unit

    @command("[:SOURce]:APPLy:SQUare")
    def _apply_square(self, text: str) -> None:
        values = words(text)
        if len(values) > 3:
            raise ScpiError(*OUT_OF_RANGE)
        self._set_function("SQU")
        self.duty_percent = 50.0
        for header, value in zip((":FREQ", ":VOLT", ":VOLT:OFFS"), values, strict=False):
            self.carry_out(f"{header} {value}")
        self.on = True
        self._apply()

    @command(":OUTPut:LOAD")
    def _set_load(self, text: str) -> None:
        """Amplitude and offset stay what the terminal really gives: those that are displayed change with it."""
        before = self._share
        self.load_ohm = self.number(text, 1.0, 1e4, "Ohm", INF=INFINITE_OHM, INFINITY=INFINITE_OHM, MAX=INFINITE_OHM)
        if self.load_ohm == INFINITE_OHM and self.amplitude_unit == "DBM":
            self.amplitude_unit = "VPP"
        self.amplitude_V *= self._share / before
        self.offset_V *= self._share / before
        self._apply()


SIMULATOR = Agilent33250A
