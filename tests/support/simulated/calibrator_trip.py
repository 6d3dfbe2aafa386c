"""A fault that no person can switch at the served bench: the calibrator trips at a time that is known before."""

from bench.model.clock import NS
from sim_instruments.worlds.common.world import World


def trip_calibrator(world: World, t_mono_ns: int) -> None:
    """Let whatever instrument can trip (the calibrator) drop to standby at that time."""
    world.after((t_mono_ns - world.clock.now_ns()) / NS, world.wiring.on_lost_path)
