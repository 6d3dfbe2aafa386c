"""What a simulated bench really does at this moment, as plain values: no readback, the simulated truth itself."""

from __future__ import annotations

from typing import Any

from bench.model.clock import NS
from sim_instruments.worlds.common.world import World

WATCH_S = 0.02


class OutputWatch:
    """Notes when the outputs of each instrument last changed; ``look`` is called each ``WATCH_S`` of the bench."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._last = {role: device.outputs() for role, device in world.instruments.items()}
        self._changed_ns = dict.fromkeys(self._last, world.clock.now_ns())

    def look(self) -> None:
        """Compare all outputs with what they were."""
        with self._world.lock:
            now_ns = self._world.clock.now_ns()
            for role, device in self._world.instruments.items():
                outputs = device.outputs()
                if outputs != self._last[role]:
                    self._last[role], self._changed_ns[role] = outputs, now_ns

    def unchanged_s(self, role: str) -> float:
        """Return seconds of the bench's time since an output of this role last changed."""
        return (self._world.clock.now_ns() - self._changed_ns[role]) / NS


def bench_state(world: World, watch: OutputWatch) -> dict[str, Any]:
    """Outputs by role, the chamber's air, the unit and its inputs, and the faults that are on.

    Units are in the names; ``unchanged_s`` is seconds of the bench's time since an output of that role last changed.
    """
    watch.look()
    with world.lock:
        now_ns = world.clock.now_ns()
        roles = {
            role: {"model": type(device).__name__, **device.outputs(), "unchanged_s": watch.unchanged_s(role)}
            for role, device in world.instruments.items()
        }
        return {
            "time_s": now_ns / NS,
            "instruments": roles,
            "loop_current_A": world.wiring.loop_current_A,
            "chamber_air_degC": float(world.thermal.air_degC(now_ns)),
            "unit": {
                "powered": world.supplied_V > 0.0,
                "temperature_degC": float(world.thermal.unit_degC(now_ns)),
                "inputs_A": {str(channel): value for channel, value in world.wiring.channel_inputs_A().items()},
            },
            "faults": world.switches.on,
        }
