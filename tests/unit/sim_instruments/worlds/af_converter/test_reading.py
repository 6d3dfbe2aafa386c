"""What the simulated unit sends does not depend on who reads when, trips and link faults included."""

import numpy as np
import pytest
from ngu_rig import PORTS, decoded, gate_frames, powered_unit, send_command, warm

from bench.frame import load_frame
from bench.model.clock import NS, VirtualClock, to_ns
from bench.model.shipped import find_shipped
from sim_instruments.faults.switchboard import LinkFaults


def _scenario(seed, period_s, *, observer, trips, integrated=False):
    """120 s with changes by the sleeping thread, polls each ``period_s`` and trips by a task of their own."""
    clock, unit = powered_unit(seed, warm)
    received = {name: [] for name in PORTS}

    def poll():
        for name in PORTS:
            received[name].append(unit.read(name, 10**7))

    clock.every(period_s, poll, observer=observer)
    trips = list(trips)

    def trip():
        if trips and clock.now_ns() >= trips[0]:
            trips.pop(0)
            unit.set_open(3, clock.now_ns())

    clock.every(0.013, trip, observer=True)  # breaks its promise: the unit has to go back
    if integrated:
        send_command(unit, 2, b"\x00")
    for turn in range(6):
        unit.set_input(3, (-1) ** turn * 0.01234, clock.now_ns())
        unit.set_fg(1e7 + turn, clock.now_ns())
        clock.sleep(0.0123456)
        unit.set_input(8, turn * 1e-3, clock.now_ns())
        if turn == 3:
            send_command(unit, 4)
        clock.sleep(20.0)
    clock.sleep(1.0)
    poll()
    return {name: b"".join(parts) for name, parts in received.items()}


def test_the_bytes_do_not_depend_on_who_reads_when():
    """Nothing happens unforeseen in the first 26 s; then two trips send the unit back."""
    trips = to_ns(26.0), to_ns(71.5)
    step_by_step = _scenario(9, 0.0213, observer=False, trips=trips)  # an acting task each 21 ms: never works ahead
    far_ahead = _scenario(9, 1.0, observer=True, trips=trips)
    odd = _scenario(9, 3.7, observer=True, trips=trips)
    assert len(far_ahead["port_a"]) > 11_000 * 57
    assert far_ahead == step_by_step
    assert far_ahead == odd


class _RealTime:
    """A clock that is moved from outside: the unit cannot know until when nothing changes."""

    virtual = False
    t_ns = 0

    def now_ns(self):
        return self.t_ns


def test_the_bytes_are_the_same_in_real_time():
    sent = []
    for clock in (VirtualClock(), _RealTime()):
        _, unit = powered_unit(3, clock=clock)
        parts = []
        for tick in range(1, 61):
            if clock.virtual:
                clock.sleep_until_ns(tick * NS // 10)
            else:
                clock.t_ns = tick * NS // 10
            if tick == 33:
                unit.set_input(1, 1e-3, clock.now_ns())
            parts.append(unit.read("port_a", 10**6))
        sent.append(b"".join(parts))
    assert len(sent[0]) > 490 * 57
    assert sent[0] == sent[1]


def test_another_seed_sends_other_bytes():
    assert _scenario(9, 1.0, observer=True, trips=()) != _scenario(10, 1.0, observer=True, trips=())


def test_integrated_frames_do_not_depend_on_who_reads_when():
    trips = (to_ns(26.0), to_ns(71.5))
    step_by_step = _scenario(9, 0.05, observer=False, trips=trips, integrated=True)
    far_ahead = _scenario(9, 1.0, observer=True, trips=trips, integrated=True)
    assert len(decoded(far_ahead["port_a"], "ngu_a_100s")["frame"]) == 1
    assert far_ahead == step_by_step


def test_a_fault_and_a_trip_change_nothing_that_was_read():
    faults = LinkFaults(seed=1, name="port_a")
    clock, unit = powered_unit(6, faults=faults)
    received = []
    clock.every(1.0, lambda: received.append(unit.read("port_a", 10**7)))

    def lose_the_path():
        if not faults.silent:
            faults.silent = True
            unit.set_open(1, clock.now_ns())

    unit.set_input(1, 0.1, 0)
    clock.every(20.5, lose_the_path)
    clock.sleep(60)
    frames = gate_frames(b"".join(received))
    assert frames.raw("counter").tolist() == list(range(1950))
    assert (frames.raw("npp")[10:, 0] > 700).all()


def test_a_trip_ends_the_pulses_at_its_time():
    clock, unit = powered_unit(options={"noise": "off"})
    received = []
    clock.every(1.0, lambda: received.append(unit.read("port_a", 10**7)))
    unit.set_input(1, 0.1, 0)
    clock.every(33.333, lambda: unit.set_open(1, to_ns(33.333)), observer=True)
    clock.sleep(60)
    npp = gate_frames(b"".join(received)).raw("npp")[:, 0].astype(np.int64)
    last = int(np.flatnonzero(npp > 10)[-1])
    assert last == int((33.333 - 1.0) * 100)
    assert npp.sum() == pytest.approx(
        0.1 * (33.333 - 1.0) / (1.25e-6 * (1 + 1e-6 * unit.truth.dsf_n_ppm(1, 31.0))), rel=1e-4
    )


# --- faults of the link ----------------------------------------------------------------------------------------------


def _with_faults(period_s):
    clock = VirtualClock()
    faults = LinkFaults(seed=5, name="port_a", bit_error_rate=2e-5, drop_rate=0.01, duplicate_rate=0.02)
    clock, unit = powered_unit(5, clock=clock, faults=faults)
    received = []
    clock.every(period_s, lambda: received.append(unit.read("port_a", 10**7)))
    clock.sleep(101.5)
    return b"".join(received)


def test_link_faults_damage_the_stream_at_their_rates():
    decoder = load_frame(find_shipped("frames", "ngu_a")).decoder()
    batch = decoder.feed(_with_faults(0.5))
    counter = batch.messages["frame"].raw("counter").astype(np.int64)
    good = 10_050 * (1 - 2e-5) ** (57 * 8)
    assert len(np.unique(counter)) == pytest.approx(good * 0.99, rel=0.01)
    assert (np.diff(counter) == 0).sum() == pytest.approx(good * 0.02, rel=0.25)
    assert decoder.counts.bad > 40


def test_link_faults_do_not_depend_on_who_reads_when():
    assert _with_faults(0.5) == _with_faults(1.75) == _with_faults(0.05)
