"""The ohms functions that the 34401A and the 34970A have in common: ranges, accuracy, integration time, overload.

Source: 34401A Service Guide, gain verification (one-year limits; 200 mohm more in two-wire without null), 34401A User's
Guide, resolution and integration time; 34970A data sheet (the same one-year limits, 4 ohm more in two-wire).
Placeholder: the noise, taken as a third of the resolution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim_instruments.bus.scpi import ScpiDevice, ScpiError
from sim_instruments.worlds.common.terminals import Source

LINE_HZ = 50.0
OVER_RANGE = 1.2
# 95 % limits after one year: of reading, of range
ACCURACY = {
    1e2: (100e-6, 40e-6), 1e3: (100e-6, 10e-6), 1e4: (100e-6, 10e-6), 1e5: (100e-6, 10e-6),
    1e6: (100e-6, 10e-6), 1e7: (400e-6, 10e-6), 1e8: (8000e-6, 100e-6),
}  # fmt: skip
RANGES_OHM = tuple(ACCURACY)
RESOLUTION = {0.02: 1e-4, 0.2: 1e-5, 1.0: 3e-6, 10.0: 1e-6, 100.0: 3e-7}  # power-line cycles: fraction of the range
UNREACHED = (532, "Cannot achieve requested resolution")
AUTOMATIC = ("", "DEF", "AUTO")


def cycles_for(share: float) -> float | None:
    """Return the lowest integration time, power-line cycles, whose resolution is at most a share of the range."""
    return next((cycles for cycles, resolved in RESOLUTION.items() if resolved <= share), None)


@dataclass
class InputSetting:
    """Setting of one input: wires (none for volts), range in ohm or volt (None: automatic), power-line cycles.

    ``first``: the range that an automatic one begins with.
    """

    wires: int
    range: float | None
    cycles: float
    first: float = 1e3

    @property
    def nominal(self) -> float:
        """The range as it is told."""
        return self.range or self.first

    @property
    def automatic(self) -> bool:
        """Whether it ranges by itself; ends with the range that there is."""
        return self.range is None

    @automatic.setter
    def automatic(self, on: bool) -> None:
        self.range = None if on else self.nominal

    @property
    def resolution(self) -> float:
        """What can be told apart, which the integration time gives."""
        return RESOLUTION[self.cycles] * self.nominal

    @resolution.setter
    def resolution(self, asked: float) -> None:
        self.cycles = cycles_for(asked / self.nominal) or max(RESOLUTION)


class Ohmmeter:
    """Errors of one instrument's ohms ranges, drawn once; ``two_wire_ohm``: most that its own path adds, 95 %."""

    def __init__(self, device: ScpiDevice, model: str, two_wire_ohm: float) -> None:
        self._device, self._model = device, model
        self._noise = device.rng(f"{model} ohms noise")
        self._path_ohm = abs(device.rng(f"{model} two-wire path").normal(0.0, two_wire_ohm / 2))

    def configured(self, wires: int, parameters: Sequence[str], cycles: float) -> InputSetting:
        """Return the setting of ``CONFigure`` with the parameters range and resolution, both of them optional."""
        first, second = (word.strip().upper() for word in (*parameters, "", "")[:2])
        range_ohm = None if first in AUTOMATIC else self.range_of(first)
        if second in AUTOMATIC:
            return InputSetting(wires, range_ohm, cycles)
        asked_ohm = self._device.number(second, 3e-5, 1e4)
        cycles_asked = cycles_for(asked_ohm * (1 + 1e-9) / (range_ohm or RANGES_OHM[0]))
        if cycles_asked is None:
            raise ScpiError(*UNREACHED)
        return InputSetting(wires, range_ohm, cycles_asked)

    def range_of(self, text: str) -> float:
        """Return the lowest range that holds a resistance."""
        largest_ohm = self._device.number(text, 0.0, RANGES_OHM[-1])
        return next(range_ohm for range_ohm in RANGES_OHM if largest_ohm <= range_ohm)

    def cycles_of(self, text: str, offered: Sequence[float] = tuple(RESOLUTION)) -> float:
        """Return the lowest of the integration times that is as long as asked for, power-line cycles."""
        asked = self._device.number(text, offered[0], offered[-1])
        return next(cycles for cycles in offered if asked <= cycles)

    def reading(self, setting: InputSetting, source: Source | None) -> str:
        """Return what is read of a source, open terminals as overload."""
        if source is None:
            return self._device.overload
        true_ohm = source.ohm(setting.wires, self._device.now_ns) + (self._path_ohm if setting.wires == 2 else 0.0)
        fitting = (range_ohm for range_ohm in RANGES_OHM if true_ohm <= OVER_RANGE * range_ohm)
        range_ohm = next(fitting, RANGES_OHM[-1]) if setting.range is None else setting.range
        if true_ohm > OVER_RANGE * range_ohm:
            return self._device.overload
        noise_ohm = range_ohm * 1e-6 / 3 * (10.0 / setting.cycles) ** 0.5 * self._noise.normal()
        return f"{true_ohm + self.error_ohm(range_ohm, true_ohm) + noise_ohm:+.8E}"

    def error_ohm(self, range_ohm: float, true_ohm: float) -> float:
        """Return what a range adds to a resistance by its gain and its zero, ohm."""
        of_reading, of_range = (limit / 2 for limit in ACCURACY[range_ohm])
        number = RANGES_OHM.index(range_ohm)
        gain = self._device.rng(f"{self._model} ohms gain", number).normal(0.0, of_reading)
        zero = self._device.rng(f"{self._model} ohms zero", number).normal(0.0, of_range)
        return float(true_ohm * gain + range_ohm * zero)
