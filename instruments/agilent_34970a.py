"""Agilent 34970A data acquisition unit: thermocouples (laboratory ambient first, then the chamber's), resistances.

Each measurement begins with ``CONFigure``, which resets all else of its channels (scaling, delay, integration), the
trigger and the form of readings, and makes the channels the scan list; what it leaves alone, or may (unit, autozero),
stands in the state table. The list is scanned in ascending order, whatever the order in which it was given.

Resistance is measured with four wires through a 34901A: channel n carries the current, channel n+10 is its pair and
senses, so that only channels 1 to 10 of a slot can be named. The reference junction is the terminal block's own sensor.

Source: 34970A/34972A Command Reference (CONFigure, ROUTe:SCAN, READ?, FRESistance:NPLC, and what the state table
names). Not confirmed on hardware: the time a scan takes (10 s is allowed).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from bench.model.ports import Parameter, action
from instruments.commands import either
from instruments.scpi import RANGES_OHM, ScpiInstrument, is_range
from instruments.values import exponent_form, read_number, read_text

_SCAN_LIMIT_S = 10.0
_THERMOCOUPLES = "BEJKNRST"
_NONE = "none"
_PAIRED = 10  # a channel's partner in a 34901A
_FOUR_WIRE = tuple(100 * slot + channel for slot in (1, 2, 3) for channel in range(1, _PAIRED + 1))


def read_scan_list(reply: str) -> str:
    """Return the list of a ``ROUT:SCAN?`` reply such as ``#210(@101,102)``. Raises: ValueError if there is none."""
    return reply[reply.index("(@") :].replace(" ", "")


class Agilent34970A(ScpiInstrument):
    """Measurement of temperatures and resistances.

    Options: ``channels`` of the thermocouples (101 = slot 1, channel 1 ...) and their type, ``thermocouple``; a unit
    without them has an empty list and the type "none".
    """

    identity_pattern = r"(HEWLETT-PACKARD|HP|AGILENT.*|KEYSIGHT.*),34970A"
    safe_state = "scan aborted (ABOR); the logger drives nothing"
    default_options: ClassVar[dict[str, Any]] = {"channels": [101, 102], "thermocouple": "T"}

    @action(bus_s=3.0, returns="degC")
    def scan(self) -> list[float]:
        """Measure every thermocouple once, degC, in the order of the option ``channels``.

        Raises: InstrumentError B-INST-007 if a thermocouple is open, B-INST-004 if readings are missing, B-INST-008 if
        the unit has none.
        """
        if not self.options["channels"]:
            raise self.refusal("scan: the station gives the unit no thermocouples")
        channels, kind = self.station_words.values()
        self._configure(f"TEMP TC,{kind}", channels, lambda reply: reply.startswith(f'"TEMP TC,{kind},'))
        self.bring("scan")
        return self.measured(self._read_scan, _SCAN_LIMIT_S)

    @action(
        Parameter("channel", choices=_FOUR_WIRE),
        Parameter("range", "ohm", RANGES_OHM[0], RANGES_OHM[-1], values=RANGES_OHM),
        Parameter("cycles", choices=(1, 10)),
        bus_s=1.0,
        returns="ohm",
    )
    def measure_resistance(self, channel: int, range: float, cycles: int) -> float:  # noqa: A002 - as in sequences
        """Measure the resistance at one channel with four wires, ohm, integrated over so many power-line cycles.

        Raises: InstrumentError B-INST-008 (also for a channel that has a thermocouple), B-INST-007 on overload (above
        120 % of the range) and with open leads.
        """
        if taken := {channel, channel + _PAIRED} & set(self.options["channels"]):
            raise self.refusal(f"channel {taken.pop()} has a thermocouple")
        self._configure(f"FRES {exponent_form(range)}", str(channel), lambda reply: is_range(reply, range))
        self.set(f"FRES:NPLC {cycles},(@{channel})", self.number(f"FRES:NPLC? (@{channel})", cycles, 0.0))
        return self.measured(read_number, _SCAN_LIMIT_S)

    def _configure(self, measurement: str, channels: str, shows: Callable[[str], bool]) -> None:
        """Set a measurement of these channels, and only of them; ``shows``: whether a ``CONF?`` reply shows it."""

        def is_configured() -> bool:
            scanned = self.ask("ROUT:SCAN?", read_scan_list)
            return scanned == f"(@{channels})" and shows(self.ask(f"CONF? {scanned}", read_text))

        self.set(f"CONF:{measurement},(@{channels})", either(is_configured, True))

    def _read_scan(self, reply: str) -> list[float]:
        readings = [read_number(reading) for reading in reply.split(",")]
        if len(readings) != len(self.options["channels"]):
            raise ValueError(f"{len(self.options['channels'])} readings are due")
        return readings

    @classmethod
    def wrong_option(cls, options: Mapping[str, Any]) -> tuple[str, str] | None:
        channels, kind = options["channels"], options["thermocouple"]
        valid = isinstance(channels, list) and all(
            type(channel) is int and 101 <= channel <= 320 for channel in channels
        )
        if not valid or channels != sorted(set(channels)) or (not channels and kind != _NONE):
            return (
                "channels",
                f"channels {channels!r} must be numbers 101 to 320 in ascending order, as they are scanned",
            )
        if channels and kind == _NONE:
            return "thermocouple", f"thermocouple {_NONE} goes with 'channels: []', not with {channels!r}"
        if kind not in (*_THERMOCOUPLES, _NONE):
            return "thermocouple", f"thermocouple {kind!r} is none of {', '.join(_THERMOCOUPLES)}, {_NONE}"
        return None

    @property
    def station_words(self) -> Mapping[str, str]:
        """The thermocouples, for the state table."""
        return {"channels": ",".join(map(str, self.options["channels"])), "thermocouple": self.options["thermocouple"]}

    _go_safe = ScpiInstrument.abort


DRIVER = Agilent34970A
