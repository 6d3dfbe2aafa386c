"""The simulated unit in time, its commands and ports through pySerial; what it sends whoever reads when."""

import numpy as np
import pytest
import serial
from sim_bench import plain_thermal

from bench.frame import load_frame
from bench.model.clock import NS, VirtualClock, to_ns
from bench.model.errors import LinkError
from bench.model.lab import find_shipped
from sim_instruments.faults.switchboard import LinkFaults
from sim_instruments.worlds.af_converter.constants import KINDS
from sim_instruments.worlds.af_converter.ngu import Ngu
from sim_instruments.worlds.af_converter.world import AfWorld

PORTS = ("port_a", "port_b")
BYTE_NS = 10 * NS / 115_200


def warm(t_ns):
    """Unit temperature of these tests: 15 degC, rising 0.6 degC/min."""
    return 15.0 + 0.01 * np.asarray(t_ns) / NS


def steady(t_ns):
    return np.full(len(t_ns), 31.0)


def powered_unit(seed=1, thermal=steady, options=None, clock=None, faults=None):
    clock = clock or VirtualClock()
    unit = Ngu(clock, seed, plain_thermal(thermal), options)
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


@pytest.mark.parametrize(
    "clocks", [{}, {"master_error_ppm": "50", "af_clock_error_ppm": "-50"}, {"master_error_ppm": "-50"}]
)
def test_equation_1_holds_for_counts_of_100_s(clocks):
    clock, unit = powered_unit(seed=4, options=clocks | {"noise": "off"})
    inputs_A = [0.1, -0.1, 0.25, -3e-4, 1e-3, 0.0, 0.02, -0.02, 5e-4, -1e-3]
    for channel, current_A in enumerate(inputs_A, start=1):
        unit.set_input(channel, current_A, 0)
    clock.sleep(161)
    frames = gate_frames(unit.read("port_a", 10**9))
    window = slice(5000, 15_000)
    n_af = frames.raw("af_clock")[window].astype(np.int64).sum()
    rates = 256_000.0 / n_af  # (N / t_INT0) r with r = f_AF0 t_INT0 / n_AF
    for channel, current_A in enumerate(inputs_A, start=1):
        k0_C = KINDS[channel - 1].k0_C
        n, p = (frames.raw(name)[window, channel - 1].astype(np.int64).sum() for name in ("npp", "ppp"))
        dsf_n, dsf_p = 1e-6 * unit.truth.dsf_ppm(channel, 31.0)
        reading_A = k0_C * rates * ((1 + dsf_n) * n - (1 + dsf_p) * p)
        truth_A = current_A - unit.truth.bias_A(channel, 31.0, 0.0)
        assert reading_A == pytest.approx(truth_A, abs=2 * k0_C / 100 + 5e-8 * abs(current_A)), channel


def test_frames_tell_the_function_generator_and_a_channel_over_range():
    clock, unit = powered_unit(seed=3)
    unit.set_fg(1e7 * (1 + 2e-6), 0)
    clock.sleep(102)
    frames = gate_frames(unit.read("port_a", 10**9))
    counted = frames.raw("fg_count")[:10_000].astype(np.int64).sum()
    assert (1e9 * (1 + 2e-6) / counted - 1) * 1e6 == pytest.approx(unit.truth.master_error_ppm(31.0), abs=0.002)
    assert set(frames.raw("master_count").tolist()) == {100_000}
    clock, unit = powered_unit()
    unit.set_fg(0.0, 0)
    clock.sleep(3)
    assert not gate_frames(unit.read("port_a", 10**6)).raw("fg_count").any()
    clock, unit = powered_unit()
    unit.set_input(7, 0.0243, to_ns(2.0))
    clock.sleep(4)
    over = gate_frames(unit.read("port_a", 10**6)).raw("status.over_range")
    assert over[:100].max() == 0
    assert set(over[100:].tolist()) == {1 << 6}


def test_frames_are_there_when_the_line_has_carried_them_by_the_master_clock():
    clock, unit = powered_unit(
        options={"master_error_ppm": "0", "noise": "off"}, thermal=lambda t: np.full(len(t), 20.0)
    )
    first_end_ns = NS + to_ns(0.01)  # one second of boot, one gate
    clock.sleep_until_ns(first_end_ns)
    assert unit.waiting("port_a") == 0
    clock.sleep_until_ns(first_end_ns + int(10 * BYTE_NS) - 1)
    assert unit.waiting("port_a") == 9
    clock.sleep_until_ns(first_end_ns + int(57 * BYTE_NS) - 1)
    assert unit.waiting("port_a") == 56
    clock.sleep_until_ns(first_end_ns + int(57 * BYTE_NS) + 60)
    assert unit.waiting("port_a") == 57
    clock, unit = powered_unit(options={"master_error_ppm": "100"}, thermal=lambda t: np.full(len(t), 20.0))
    clock.sleep(1 + 1000 / (1 + 100e-6) + 0.006)
    assert len(gate_frames(unit.read("port_a", 10**9))) == 100_000


def test_counters_count_without_gaps_and_wrap():
    clock, unit = powered_unit()
    clock.sleep(700)
    counter = gate_frames(unit.read("port_a", 10**9)).raw("counter").astype(np.int64)
    np.testing.assert_array_equal(counter, np.arange(len(counter)) % 65_536)
    housekeeping = decoded(unit.read("port_b", 10**9), "ngu_b")["housekeeping"].raw("counter")
    np.testing.assert_array_equal(housekeeping, np.arange(6989))


def test_housekeeping_tells_temperature_and_supply():
    clock, unit = powered_unit(thermal=warm)
    unit.set_power(True, to_ns(100.0), voltage_V=24.0)
    clock.sleep(201)
    frames = decoded(unit.read("port_b", 10**6), "ngu_b")["housekeeping"]
    t_s = 1.1 + 0.1 * np.arange(len(frames))
    error_degC = frames.scaled("unit_temperature") - (15.0 + 0.01 * t_s)[:, None]
    assert error_degC.std() == pytest.approx(np.hypot(0.01, 0.01 / np.sqrt(12)), rel=0.05)
    assert abs(error_degC.mean()) < 4 * 0.01 / np.sqrt(error_degC.size)
    assert frames.scaled("supply_voltage")[:980].mean() == pytest.approx(28.0, abs=0.001)
    assert frames.scaled("supply_voltage")[990:].mean() == pytest.approx(24.0, abs=0.001)


def test_nothing_is_sent_without_supply_and_what_nobody_hears_is_lost():
    clock = VirtualClock()
    unit = Ngu(clock, 1, plain_thermal(steady))
    unit.connect("port_a", 115_200)
    clock.sleep(5)
    assert unit.waiting("port_a") == 0
    unit.set_power(True, clock.now_ns())
    clock.sleep(11)
    before = gate_frames(unit.read("port_a", 10**6))
    unit.set_power(False, clock.now_ns())
    clock.sleep(1)
    unit.read("port_a", 57)
    clock.sleep(60)
    assert unit.waiting("port_a") == 0
    unit.set_power(True, clock.now_ns())
    clock.sleep(11)
    again = gate_frames(unit.read("port_a", 10**6))
    assert again.raw("counter")[0] == 0
    assert len(again) == len(before) == 999
    assert (again.raw("npp") != before.raw("npp")).any()
    clock = VirtualClock()
    unit = Ngu(clock, 1, plain_thermal(steady))
    unit.set_power(True, 0)
    clock.sleep(100)
    unit.connect("port_a", 115_200)
    clock.sleep(2)
    assert 190 * 57 <= unit.waiting("port_a") <= 201 * 57
    unit.discard("port_a")
    assert unit.waiting("port_a") == 0


def _answers(unit):
    batch = decoded(unit.read("port_b", 10**7), "ngu_b").get("answer")
    if batch is None:
        return []
    return [
        (int(c), int(s), p) for c, s, p in zip(*(batch.raw(n) for n in ("command", "status", "payload")), strict=True)
    ]


def test_the_unit_takes_commands_and_no_damaged_ones():
    clock, unit = powered_unit()
    clock.sleep(2)
    send_command(unit, 1)
    assert _answers(unit) == []
    clock.sleep(0.01)
    assert _answers(unit) == [(1, 0, b"NGU SIM-1 1.0")]
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
    clock, unit = powered_unit()
    clock.sleep(5.5)
    send_command(unit, 4)
    clock.sleep(3)
    counter = gate_frames(unit.read("port_a", 10**6)).raw("counter").astype(np.int64)
    assert np.flatnonzero(np.diff(counter) != 1).tolist() == [449]
    assert counter[450] == 0
    clock, unit = powered_unit()
    clock.sleep(2)
    definition = load_frame(find_shipped("frames", "ngu_b"))
    damaged = bytearray(definition.encode_one({"command": 3, "payload": b""}, "command"))
    damaged[4] ^= 1
    unit.write("port_b", bytes(damaged))
    unit.write("port_a", definition.encode_one({"command": 3, "payload": b""}, "command"))
    clock.sleep(1)
    assert _answers(unit) == []


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


@pytest.fixture
def world(monkeypatch):
    monkeypatch.setattr(serial, "protocol_handler_packages", [*serial.protocol_handler_packages, "sim_instruments.bus"])
    opened = AfWorld(clock=VirtualClock(), seed=1, options={}, unit_factory=unit_at_23_degC)
    opened.unit.set_power(True, 0)
    opened.url = f"sim://{opened.id}/"
    yield opened
    opened.close()


def unit_at_23_degC(clock, seed, _thermal, _options):
    return Ngu(clock, seed, plain_thermal(lambda t_ns: np.full(len(t_ns), 23.0)))


def test_what_has_arrived_is_read_or_thrown_away(world):
    with serial.serial_for_url(world.url + "port_a", baudrate=115_200, timeout=0) as port:
        world.clock.sleep(11.006)
        waiting = port.in_waiting
        received = port.read(waiting)
        assert len(received) == waiting == 57 * 1000
        assert port.in_waiting == 0
        assert port.read(100) == b""
    with serial.serial_for_url(world.url + "port_a", timeout=0) as port:
        world.clock.sleep(5)
        port.reset_input_buffer()
        assert port.in_waiting == 0


def test_a_blocking_read_waits_in_bench_time(world):
    with serial.serial_for_url(world.url + "port_a", baudrate=115_200, timeout=0.5) as port:
        assert port.read(10) == b""
        assert world.clock.now_ns() == NS // 2
        port.timeout = None
        assert port.read(57)[:2] == b"\xeb\x90"
        assert NS + 14_000_000 < world.clock.now_ns() < NS + 17_000_000


def test_line_speed_is_the_one_the_port_was_opened_with(world):
    with serial.serial_for_url(world.url + "port_a", baudrate=921_600, timeout=0) as port:
        world.clock.sleep(1.0112)
        assert port.in_waiting == 57
        port.baudrate = 115_200
        world.clock.sleep(0.010)
        assert 57 < port.in_waiting < 57 + 20


@pytest.mark.parametrize("place", ["port_c", "", "port_a/x"])
def test_a_port_that_does_not_exist_is_refused(world, place):
    with pytest.raises(LinkError) as caught:
        serial.serial_for_url(world.url + place)
    assert caught.value.code == "B-NGU-002"
    assert isinstance(caught.value, serial.SerialException)
    assert world.url in str(caught.value)


def test_a_closed_port_or_one_of_a_world_that_is_gone_cannot_be_used(world):
    port = serial.serial_for_url(world.url + "port_a")
    with pytest.raises(serial.SerialException, match="already open"):
        port.open()
    port.close()
    for use in (lambda: port.in_waiting, lambda: port.read(1), lambda: port.write(b"x"), port.reset_input_buffer):
        with pytest.raises(serial.PortNotOpenError):
            use()
    world.close()
    with pytest.raises(serial.SerialException, match="B-NGU-002"):
        serial.serial_for_url(world.url + "port_a")


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
            unit.set_input(3, 0.0, clock.now_ns())

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


def test_the_bytes_depend_on_the_seed_and_not_on_who_reads_when():
    """Nothing happens unforeseen in the first 26 s; then two trips send the unit back."""
    trips = to_ns(26.0), to_ns(71.5)
    step_by_step = _scenario(9, 0.0213, observer=False, trips=trips)  # an acting task each 21 ms: never works ahead
    far_ahead = _scenario(9, 1.0, observer=True, trips=trips)
    odd = _scenario(9, 3.7, observer=True, trips=trips)
    assert len(far_ahead["port_a"]) > 11_000 * 57
    assert far_ahead == step_by_step
    assert far_ahead == odd
    trips = (to_ns(26.0), to_ns(71.5))
    step_by_step = _scenario(9, 0.05, observer=False, trips=trips, integrated=True)
    far_ahead = _scenario(9, 1.0, observer=True, trips=trips, integrated=True)
    assert len(decoded(far_ahead["port_a"], "ngu_a_100s")["frame"]) == 1
    assert far_ahead == step_by_step
    assert _scenario(9, 1.0, observer=True, trips=()) != _scenario(10, 1.0, observer=True, trips=())


def test_a_fault_and_a_trip_change_nothing_that_was_read():
    faults = LinkFaults(seed=1, name="port_a")
    clock, unit = powered_unit(6, faults=faults)
    received = []
    clock.every(1.0, lambda: received.append(unit.read("port_a", 10**7)))

    def lose_the_path():
        if not faults.silent:
            faults.silent = True
            unit.set_input(1, 0.0, clock.now_ns())

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
    clock.every(33.333, lambda: unit.set_input(1, 0.0, to_ns(33.333)), observer=True)
    clock.sleep(60)
    npp = gate_frames(b"".join(received)).raw("npp")[:, 0].astype(np.int64)
    last = int(np.flatnonzero(npp > 10)[-1])
    assert last == int((33.333 - 1.0) * 100)
    assert npp.sum() == pytest.approx(
        0.1 * (33.333 - 1.0) / (1.25e-6 * (1 + 1e-6 * unit.truth.dsf_ppm(1, 31.0)[0])), rel=1e-4
    )


def _with_faults(period_s):
    clock = VirtualClock()
    faults = LinkFaults(seed=5, name="port_a", bit_error_rate=2e-5, drop_rate=0.01, duplicate_rate=0.02)
    clock, unit = powered_unit(5, clock=clock, faults=faults)
    received = []
    clock.every(period_s, lambda: received.append(unit.read("port_a", 10**7)))
    clock.sleep(101.5)
    return b"".join(received)


def test_link_faults_damage_the_stream_at_their_rates_whoever_reads_when():
    decoder = load_frame(find_shipped("frames", "ngu_a")).decoder()
    batch = decoder.feed(_with_faults(0.5))
    counter = batch.messages["frame"].raw("counter").astype(np.int64)
    good = 10_050 * (1 - 2e-5) ** (57 * 8)
    assert len(np.unique(counter)) == pytest.approx(good * 0.99, rel=0.01)
    assert (np.diff(counter) == 0).sum() == pytest.approx(good * 0.02, rel=0.25)
    assert decoder.counts.bad > 40
    assert _with_faults(0.5) == _with_faults(1.75) == _with_faults(0.05)
