"""The simulated unit under test: ten charge-balance AF converters, two oscillators, two serial ports.

Sign convention of the whole unit: K_N C_N - K_P C_P = i_in - i_AFbias, so positive input current makes N pulses and
the reading with an open input is -i_AFbias (AF-converter paper, equation (1)).
"""

from __future__ import annotations

import threading
from collections.abc import Mapping

from bench.model.clock import Clock, VirtualClock
from sim_instruments.faults.switchboard import LinkFaults
from sim_instruments.worlds.af_converter.core import AHEAD_NS, CommandReader, Request, UnitCore
from sim_instruments.worlds.af_converter.unit_constants import NguTruth
from sim_instruments.worlds.common.port import Int64, Port
from sim_instruments.worlds.common.thermal import TemperatureFunction

ANSWER_NS = 2_000_000  # from a command to its answer
NOMINAL_SUPPLY_V = 28.0


class Ngu:
    """One simulated unit with the ports "port_a" (measurement) and "port_b" (housekeeping, commands, answers).

    Args:
        clock: clock of the run; with a virtual one the unit works ahead while nothing can change it.
        seed: seed of the unit's truth and of all its noise.
        thermal: unit temperature, degC, at bench times in nanoseconds, (n,) to (n,); a ``UnitTemperature`` also
            tells where it has turned, a plain function has no past and shows no hysteresis.
        options: see NguTruth.
        sensed: temperature at its sensors, where that is another one.   serial: serial number that it answers.
    Raises:
        InputError: B-NGU-001, an option cannot be read.
    """

    def __init__(
        self, clock: Clock, seed: int, thermal: TemperatureFunction, options: Mapping[str, str] | None = None,
        *, sensed: TemperatureFunction | None = None, serial: str = "",
    ) -> None:  # fmt: skip
        self.truth = NguTruth(seed, options)
        self._ports = {"port_a": Port(), "port_b": Port()}
        self._clock = clock
        self._lock = threading.RLock()
        self._core = UnitCore(self.truth, thermal, self._ports, clock.now_ns(), sensed, serial)
        self._commands = CommandReader(self._core.definition_b)

    # --- the bench ---------------------------------------------------------------------------------------------

    def set_input(self, channel: int, current_A: float, t_ns: int) -> None:
        """Current into a channel (from 1) from ``t_ns`` on, ampere; positive makes N pulses."""
        with self._lock:
            self._core.at(t_ns, lambda t: self._core.set_input(channel, current_A, t))

    def set_open(self, channel: int, t_ns: int) -> None:
        """Nothing is connected to a channel from ``t_ns`` on."""
        self.set_input(channel, 0.0, t_ns)

    def set_fg(self, frequency_Hz: float, t_ns: int) -> None:
        """True frequency at the reference input from ``t_ns`` on, hertz; 0 without a signal."""
        with self._lock:
            self._core.at(t_ns, lambda t: self._core.set_fg(frequency_Hz, t))

    def set_power(self, on: bool, t_ns: int, voltage_V: float = NOMINAL_SUPPLY_V) -> None:
        """Supply on or off from ``t_ns`` on; switched on, the unit boots for a second and then streams 100 Hz."""
        with self._lock:
            self._core.at(t_ns, lambda t: self._core.set_power(voltage_V if on else 0.0, t))

    # --- the ports ---------------------------------------------------------------------------------------------

    def has_port(self, name: str) -> bool:
        """Return whether the unit has a port of this name."""
        return name in self._ports

    def connect(self, name: str, baud: int, faults: LinkFaults | None = None) -> None:
        """Listen to a port from now on, bits per second; ``faults`` damages what the unit sends from now on."""
        with self._lock:
            self._upto_now()
            self._ports[name].connect(baud, faults)

    def disconnect(self, name: str) -> None:
        """Stop listening to a port."""
        with self._lock:
            self._ports[name].disconnect()

    def waiting(self, name: str) -> int:
        """Return bytes that have arrived at a port by now and are not read."""
        with self._lock:
            return self._ports[name].waiting(self._upto_now())

    def read(self, name: str, size: int) -> bytes:
        """Return up to ``size`` bytes of those that have arrived by now."""
        with self._lock:
            return self._ports[name].read(size, self._upto_now())

    def arrivals(self, name: str, t_ns: Int64) -> Int64:
        """Return bytes that can be read at each of the coming times, as far as the unit has worked ahead."""
        with self._lock:
            self._upto_now()
            return self._ports[name].arrivals(t_ns[t_ns <= self._core.generated_ns])

    def discard(self, name: str) -> None:
        """Lose what has arrived by now."""
        with self._lock:
            self._ports[name].discard(self._upto_now())

    def write(self, name: str, sent: bytes) -> None:
        """Send bytes to the unit; only port B listens, and it answers each sound command 2 ms later."""
        with self._lock:
            now_ns = self._upto_now()
            for request in self._commands.feed(sent) if name == "port_b" else ():
                self._answer(request, now_ns + ANSWER_NS)

    def _answer(self, request: Request, t_ns: int) -> None:
        self._core.at(t_ns, lambda t: self._core.execute(request, t))

    def _upto_now(self) -> int:
        """Generate what has arrived by now, and ahead while nobody can change anything; returns now."""
        now_ns = self._clock.now_ns()
        core = self._core
        if core.generated_ns < now_ns:
            quiet_ns = self._clock.quiet_until_ns() if isinstance(self._clock, VirtualClock) else now_ns
            core.generate(max(now_ns, min(quiet_ns, core.generated_ns + AHEAD_NS)))
        if core.given_ns < now_ns:
            core.given_ns = now_ns
            for port in self._ports.values():
                if not port.listened:
                    port.discard(now_ns)
        return now_ns
