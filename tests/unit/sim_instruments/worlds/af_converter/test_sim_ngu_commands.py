"""Commands to the simulated unit and the answers it gives."""

import numpy as np
import pytest
from ngu_rig import decoded, gate_frames, powered_unit, send_command

from bench.frame import load_frame
from bench.model.shipped import find_shipped


def _answers(unit):
    batch = decoded(unit.read("port_b", 10**7), "ngu_b").get("answer")
    if batch is None:
        return []
    return [
        (int(c), int(s), p) for c, s, p in zip(*(batch.raw(n) for n in ("command", "status", "payload")), strict=True)
    ]


def test_the_unit_identifies_itself():
    clock, unit = powered_unit()
    clock.sleep(2)
    send_command(unit, 1)
    assert _answers(unit) == []
    clock.sleep(0.01)
    assert _answers(unit) == [(1, 0, b"NGU SIM-1 1.0")]


def test_the_stream_stops_and_starts():
    clock, unit = powered_unit()
    clock.sleep(2)
    send_command(unit, 3)
    clock.sleep(1)
    unit.discard("port_a")
    clock.sleep(5)
    assert unit.waiting("port_a") == 0
    send_command(unit, 2, b"\x64")
    clock.sleep(5)
    assert unit.waiting("port_a") > 490 * 57
    assert [answer[:2] for answer in _answers(unit)] == [(3, 0), (2, 0)]
    assert int(gate_frames(unit.read("port_a", 10**6)).raw("counter")[0]) == 700


def test_counters_start_again_at_zero():
    clock, unit = powered_unit()
    clock.sleep(5.5)
    send_command(unit, 4)
    clock.sleep(3)
    counter = gate_frames(unit.read("port_a", 10**6)).raw("counter").astype(np.int64)
    assert np.flatnonzero(np.diff(counter) != 1).tolist() == [449]
    assert counter[450] == 0


def test_integrated_frames_hold_the_sums_of_10000_gates():
    clock, unit = powered_unit(7)
    unit.set_input(2, 0.123, 0)
    send_command(unit, 2, b"\x00")
    clock.sleep(1 + 2 * 100 + 0.1)
    twin_clock, twin = powered_unit(7)
    twin.set_input(2, 0.123, 0)
    twin_clock.sleep(1 + 2 * 100 + 0.1)
    integrated = decoded(unit.read("port_a", 10**6), "ngu_a_100s")["frame"]
    gates = gate_frames(twin.read("port_a", 10**8))
    assert integrated.raw("counter").tolist() == [0, 1]
    for name in ("npp", "ppp", "af_clock", "master_count", "fg_count"):
        sums = gates.raw(name)[:20_000].astype(np.int64).reshape(2, 10_000, -1).sum(axis=1)
        np.testing.assert_array_equal(integrated.raw(name).reshape(2, -1), sums)
    assert integrated.raw("status.mode").tolist() == [1, 1]


@pytest.mark.parametrize(("command", "payload", "status"), [(77, b"", 1), (2, b"\x07", 2), (1, b"x", 2)])
def test_what_the_unit_cannot_do_is_answered_with_a_status(command, payload, status):
    clock, unit = powered_unit()
    clock.sleep(2)
    send_command(unit, command, payload)
    clock.sleep(0.1)
    assert _answers(unit) == [(command, status, b"")]


def test_damaged_commands_are_not_answered():
    clock, unit = powered_unit()
    clock.sleep(2)
    definition = load_frame(find_shipped("frames", "ngu_b"))
    damaged = bytearray(definition.encode_one({"command": 3, "payload": b""}, "command"))
    damaged[4] ^= 1
    unit.write("port_b", bytes(damaged))
    unit.write("port_a", definition.encode_one({"command": 3, "payload": b""}, "command"))
    clock.sleep(1)
    assert _answers(unit) == []
