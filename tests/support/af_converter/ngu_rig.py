"""What the tests of the simulated unit share: a unit on a virtual clock, and its frames decoded."""

import numpy as np

from bench.frame import load_frame
from bench.model.clock import NS, VirtualClock
from bench.model.shipped import find_shipped
from sim_instruments.worlds.af_converter.ngu import Ngu

PORTS = ("port_a", "port_b")
BYTE_NS = 10 * NS / 115_200


def warm(t_ns):
    """Unit temperature of these tests: 15 degC, rising 0.6 degC/min."""
    return 15.0 + 0.01 * np.asarray(t_ns) / NS


def steady(t_ns):
    return np.full(len(t_ns), 31.0)


def powered_unit(seed=1, thermal=steady, options=None, clock=None, faults=None):
    clock = clock or VirtualClock()
    unit = Ngu(clock, seed, thermal, options)
    for name in PORTS:
        unit.connect(name, 115_200, faults)
    unit.set_power(True, clock.now_ns())
    unit.set_fg(1e7, clock.now_ns())
    return clock, unit


def decoded(sent, name):
    decoder = load_frame(find_shipped("frames", name)).decoder()
    batches = [decoder.feed(sent), decoder.finish()]
    assert decoder.counts.bad == 0
    return {message: batch for message, batch in batches[0].messages.items() if len(batch)}


def gate_frames(sent):
    return decoded(sent, "ngu_a")["frame"]


def send_command(unit, command, payload=b""):
    definition = load_frame(find_shipped("frames", "ngu_b"))
    unit.write("port_b", definition.encode_one({"command": command, "payload": payload}, "command"))
