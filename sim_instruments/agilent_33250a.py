"""Simulated Agilent 33250A function generator; the output of the first one goes to the unit's
function-generator input.

Source: 33250A User's Guide (remote interface, ranges of square waves, load and amplitude). The unit's input has a high
impedance: with the load setting at 50 ohm its amplitude is twice the programmed one.
"""

from __future__ import annotations

from typing import Any, ClassVar

from sim_instruments.bus.scpi import OUT_OF_RANGE, SETTINGS_CONFLICT, Answers, ScpiDevice, ScpiError, command, words

FREQUENCY_ERROR_PPM = 3.0
UNIT_THRESHOLD_VPP = 0.5  # smaller signals are not counted by the unit
INFINITE_OHM = 9.9e37
_HIGHEST_HZ = {"SIN": 80e6, "SQU": 80e6, "RAMP": 1e6, "PULS": 50e6, "NOIS": 80e6, "DC": 80e6}


class Agilent33250A(ScpiDevice):
    """Function generator; its frequency error is drawn once, uniform within 3 ppm."""

    identity = "Agilent Technologies,33250A,SIM33250,1.05-1.01-1.00-03-1"
    answers: ClassVar[Answers] = {
        "[:SOURce]:FUNCtion[:SHAPe]?": lambda self: self.function,
        "[:SOURce]:FREQuency?": lambda self: f"{self.frequency_Hz:+.13E}",
        "[:SOURce]:VOLTage?": lambda self: f"{self.amplitude_V:+.13E}",
        "[:SOURce]:VOLTage:OFFSet?": lambda self: f"{self.offset_V:+.13E}",
        "[:SOURce]:VOLTage:UNIT?": lambda self: self.amplitude_unit,
        ":OUTPut:LOAD?": lambda self: f"{self.load_ohm:+.13E}",
        ":OUTPut?": lambda self: "1" if self.on else "0",
    }

    def __init__(self, *arguments: Any) -> None:
        self.error_ppm = 0.0
        super().__init__(*arguments)
        draw = self.rng("function generator frequency")
        self.error_ppm = float(draw.uniform(-FREQUENCY_ERROR_PPM, FREQUENCY_ERROR_PPM))

    def reset(self) -> None:
        self.function, self.frequency_Hz = "SIN", 1e3
        self.amplitude_V, self.offset_V, self.amplitude_unit = 0.1, 0.0, "VPP"
        self.load_ohm, self.on = 50.0, False
        self._apply()

    @property
    def true_frequency_Hz(self) -> float:
        """Frequency at the output terminal, hertz; 0 when it is off or not periodic."""
        if not self.on or self.function in ("DC", "NOIS"):
            return 0.0
        return self.frequency_Hz * (1.0 + self.error_ppm * 1e-6)

    @property
    def open_amplitude_V(self) -> float:
        """Peak-to-peak amplitude at a high-impedance input, volt."""
        return self.amplitude_V * (1.0 if self.load_ohm == INFINITE_OHM else (self.load_ohm + 50.0) / self.load_ohm)

    def _apply(self) -> None:
        counted = self.open_amplitude_V >= UNIT_THRESHOLD_VPP
        if self.is_first:
            self.world.unit.set_fg(self.true_frequency_Hz if counted else 0.0, self.now_ns)

    def outputs(self) -> dict[str, Any]:
        return {"on": self.on, "frequency_Hz": self.frequency_Hz, "amplitude_V": self.amplitude_V}

    def _largest_V(self) -> float:
        return 10.0 * (2.0 if self.load_ohm == INFINITE_OHM else 2.0 * self.load_ohm / (self.load_ohm + 50.0))

    @command("[:SOURce]:FUNCtion[:SHAPe]")
    def _set_function(self, text: str) -> None:
        function = self.word(text, "SINusoid", "SQUare", "RAMP", "PULSe", "NOISe", "DC")
        if self.frequency_Hz > _HIGHEST_HZ[function]:
            self.frequency_Hz = _HIGHEST_HZ[function]
            self.error(*SETTINGS_CONFLICT)
        self.function = function
        self._apply()

    @command("[:SOURce]:FREQuency")
    def _set_frequency(self, text: str) -> None:
        self.frequency_Hz = round(self.number(text, 1e-6, _HIGHEST_HZ[self.function]), 6)
        self._apply()

    @command("[:SOURce]:VOLTage")
    def _set_amplitude(self, text: str) -> None:
        amplitude_V = self.number(text, self._largest_V() / 1000.0, self._largest_V())
        if amplitude_V / 2 + abs(self.offset_V) > self._largest_V() / 2:
            raise ScpiError(*SETTINGS_CONFLICT)
        self.amplitude_V = round(amplitude_V, 4)
        self._apply()

    @command("[:SOURce]:VOLTage:OFFSet")
    def _set_offset(self, text: str) -> None:
        room_V = (self._largest_V() - self.amplitude_V) / 2
        self.offset_V = self.number(text, -room_V, room_V)

    @command("[:SOURce]:VOLTage:UNIT")
    def _set_unit(self, text: str) -> None:
        if self.word(text, "VPP", "VRMS", "DBM") != "VPP":
            raise ScpiError(*SETTINGS_CONFLICT)

    @command("[:SOURce]:APPLy:SQUare")
    def _apply_square(self, text: str) -> None:
        values = words(text)
        if len(values) > 3:
            raise ScpiError(*OUT_OF_RANGE)
        self._set_function("SQU")
        for setter, value in zip((self._set_frequency, self._set_amplitude, self._set_offset), values, strict=False):
            setter(value)
        self._set_output("ON")

    @command(":OUTPut:LOAD")
    def _set_load(self, text: str) -> None:
        """The amplitude at the old load stays what the terminal really gives: the displayed value changes with it."""
        load_ohm = self.number(text, 1.0, 1e4, INF=INFINITE_OHM, INFINITY=INFINITE_OHM, MAX=INFINITE_OHM)
        open_V = self.open_amplitude_V
        self.load_ohm = load_ohm
        self.amplitude_V = open_V * (1.0 if load_ohm == INFINITE_OHM else load_ohm / (load_ohm + 50.0))
        self._apply()

    @command(":OUTPut")
    def _set_output(self, text: str) -> None:
        self.on = self.boolean(text)
        self._apply()


SIMULATOR = Agilent33250A
