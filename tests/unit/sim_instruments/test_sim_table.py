"""The simulated turntable by hand and through its driver: what it obeys, what it refuses, and its way to rest."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from gnc_rig import TableRig, open_table
from scripted import refused

from bench.model.clock import NS
from sim_instruments.acutrol_3000 import BRAKE_DEG_S2

SAFE_S = 5.0  # the deadline of safety


@pytest.fixture
def rig() -> Iterator[TableRig]:
    with open_table() as opened:
        yield opened


def test_the_status_byte_is_cleared_by_reading_and_the_queue_stays(rig: TableRig) -> None:
    rig.send(":lim:rate rate,1,50", ":dem:rate 1,50.1", ":nonsense 1")
    assert [rig.ask("*STB?"), rig.ask("*STB?")] == ["192", "0"]
    assert [rig.ask(":stat:msg? qerror") for _ in range(3)] == [
        "103,LIMIT EXCEEDED", "101,COMMAND NOT RECOGNIZED", "",
    ]  # fmt: skip
    assert rig.ask(":query:error? 103") == "LIMIT EXCEEDED"
    rig.clock.sleep(1.0)
    rig.resource.write(":dem:rate 1,1")
    rig.resource.write(":dem:rate 2,2")
    assert (rig.ask(":dem:rate? 1"), rig.ask(":dem:rate? 2")) == ("1.000000", "0.000000")
    assert rig.ask(":stat:msg? qerror") == "101,COMMAND NOT RECOGNIZED"


@pytest.mark.parametrize(
    "command",
    [
        ":dem:rate 1,400.1", ":dem:rate 1,nan", ":dem:rate 4,1", ":dem:pos 1,inf", ":lim:rate pos,1,401",
        ":lim:acc rate,1,0", ":lim:rate move,1,5", ":dem:rate 1", ":int:close", ":dem 1,1", "dem rate", ":",
    ],
)  # fmt: skip
def test_what_it_does_not_allow_is_an_error_and_does_nothing(rig: TableRig, command: str) -> None:
    rig.send(":int:close 1", ":mode:rate 1", ":dem:rate 1,12")
    before = [rig.ask(query) for query in (":lim:rate? pos,1", ":lim:acc? rate,1", ":dem:rate? 1", ":dem:pos? 1")]
    rig.send(command)
    assert int(rig.ask("*STB?")) & 128
    after = [rig.ask(query) for query in (":lim:rate? pos,1", ":lim:acc? rate,1", ":dem:rate? 1", ":dem:pos? 1")]
    assert after == before
    assert rig.rates() == [12.0, 0.0, 0.0]


def test_headers_may_be_cut_and_questions_joined(rig: TableRig) -> None:
    rig.send(":INTERLOCK:CLOSE 2", ":M:R 2", ":D:R 2, 7.5")
    rig.clock.sleep(4.0)
    position, rate = map(float, rig.ask(":read:pos? 2;rate? 2").split(";"))
    assert rate == pytest.approx(7.5, abs=2e-3)
    assert position == pytest.approx(rig.angles()[1], abs=0.2)
    assert rig.ask(":interlock? 2;:mode? 2") == "Closed;R"


def test_a_mode_that_is_activated_obeys_the_demand_that_is_loaded(rig: TableRig) -> None:
    rig.send(":int:close 1", ":dem:rate 1,20", ":dem:pos 1,5")
    assert rig.rates()[0] == 0.0
    rig.send(":mode:rate 1")
    rig.clock.sleep(1.0)
    assert rig.rates()[0] == 20.0
    rig.send(":mode:pos 1")
    rig.clock.sleep(10.0)
    assert rig.angles()[0] == 5.0


def test_the_read_out_has_steps_and_the_noise_of_an_arc_second(rig: TableRig) -> None:
    rig.send(":int:close 3", ":mode:pos 3", ":dem:pos 3,17.5")
    rig.clock.sleep(30.0)
    texts = [rig.ask(":read:pos? 3") for _ in range(400)]
    assert {len(text.partition(".")[2]) for text in texts} == {4}
    read = np.array(texts, float) - 17.5
    assert 0.8 / 3600 < read.std() < 1.2 / 3600
    assert abs(read.mean()) < 4 * read.std() / 20
    assert rig.angles()[2] == 17.5


def test_an_axis_without_drive_is_braked_to_rest(rig: TableRig) -> None:
    for command in (":int:open 3", ":mode:off 3"):
        rig.send(":int:close 3", ":mode:off 3", ":dem:rate 3,200", ":mode:rate 3")
        rig.clock.sleep(2.0)
        rig.send(command)
        here = rig.angles()[2]
        rig.clock.sleep(1.0)
        assert rig.rates()[2] == 0.0
        assert rig.angles()[2] - here == pytest.approx(200.0**2 / (2 * BRAKE_DEG_S2), abs=0.5)


def test_after_a_spin_a_move_goes_on_from_the_reading(rig: TableRig) -> None:
    driver = rig.ready()
    driver.spin(3, 90.0)
    rig.clock.sleep(180.0)
    driver.stop(3)
    rig.clock.sleep(2.0)
    began_ns = rig.clock.now_ns()
    driver.move(3, 10.0, 45.0)
    rig.clock.sleep(10.0)
    assert rig.angles()[2] % 360.0 == pytest.approx(10.0, abs=1e-9)
    assert rig.angles()[2] > 10_000.0
    assert rig.moved_deg(began_ns) <= 180.0


def spin(driver: Any, rig: TableRig) -> None:
    for axis, rate in ((1, 300.0), (2, -150.0), (3, 300.0)):
        driver.spin(axis, rate)
    rig.clock.sleep(2.0)


def turn(driver: Any, rig: TableRig) -> None:
    driver.turn(3, 1800.0, 300.0, 300.0)


def drop(driver: Any, rig: TableRig) -> None:
    spin(driver, rig)
    rig.world.switches.switch("table_interlock")


def slow(driver: Any, rig: TableRig) -> None:
    """An axis that takes 15 s to stop: the interlock opens before it rests."""
    spin(driver, rig)
    rig.send(":lim:acc rate,3,20")


def power_on(driver: Any, rig: TableRig) -> None:
    pass


@pytest.mark.parametrize("state", [power_on, spin, turn, drop, slow])
@pytest.mark.parametrize("other", [False, True])
def test_the_safe_state_is_reached_from_any_state_in_time(
    rig: TableRig, state: Callable[[Any, TableRig], None], other: bool
) -> None:
    driver = rig.driver if state is power_on else rig.ready()
    state(driver, rig)
    rig.clock.sleep(0.5)
    began_ns = rig.clock.now_ns()
    one = rig.open() if other else driver  # as the guard does, which knows nothing of what was set
    with one.quick(0.5):
        one.make_safe()
    assert set(rig.table.outputs()["interlocks"]) <= {"Open", "Fault"}
    assert rig.rates() == [0.0, 0.0, 0.0]
    took_s = rig.since_s(began_ns)
    print(f"{state.__name__}: confirmed safe after {took_s:.2f} s")
    assert took_s <= SAFE_S
    rig.clock.sleep(60.0)
    assert rig.moved_deg(rig.clock.now_ns() - 60 * NS) == 0.0


def test_a_stalled_axis_is_noticed(rig: TableRig) -> None:
    driver = rig.ready()
    driver.turn(3, 160.0, 30.0, 270.0)
    rig.world.switches.switch("table_stall", 3)
    assert rig.world.switches.on == ["table_stall 3"]
    rig.clock.sleep(10.0)
    assert rig.rates()[2] == 0.0
    assert rig.angles()[2] < 100.0
    assert not driver.in_position()
    rig.world.switches.switch("table_stall", "off")
    rig.clock.sleep(10.0)
    assert rig.angles()[2] == pytest.approx(160.0, abs=0.002)  # from a reading on, which has noise
    assert driver.in_position()


def test_an_axis_that_stalls_in_a_long_turn_is_stopped_and_told(rig: TableRig) -> None:
    driver = rig.ready()
    rig.world.switches.switch("table_stall", 3)
    with refused("B-INST-011", "from where it should be"):
        driver.turn(3, 1080.0, 270.0, 270.0)
    rig.world.switches.clear()
    rig.clock.sleep(5.0)
    assert rig.rates() == [0.0, 0.0, 0.0]
    driver.open_interlock()


def test_positions_roll_over_and_a_demand_is_reached_the_shortest_way(rig: TableRig) -> None:
    """As on the real table: who sends 1080 deg as one demand turns nothing."""
    rig.send(":int:close 3", ":mode:pos 3", ":dem:pos 3,1080")
    rig.clock.sleep(10.0)
    assert rig.angles()[2] == 0.0
    rig.send(":dem:pos 3,200")
    rig.clock.sleep(10.0)
    assert rig.angles()[2] == -160.0
    rig.send(":dem:delta 3,-40")
    rig.clock.sleep(10.0)
    assert rig.angles()[2] == -200.0
    assert float(rig.ask(":read:pos? 3")) == pytest.approx(160.0, abs=0.002)
    assert rig.ask(":dem:pos? 3") == "160.000000"


@pytest.mark.parametrize("rate", [2.0, 45.0, 270.0, 400.0])
@pytest.mark.parametrize("angle", [170.0, 170.1, 180.0, -190.0, 270.0, -360.0, 719.9, 1080.0, -3600.0])
def test_a_turn_of_any_length_is_exact_or_refused(rig: TableRig, angle: float, rate: float) -> None:
    driver = rig.ready(400.0, 400.0)
    driver.move(3, 12.5, 45.0)
    rig.clock.sleep(5.0)
    before = rig.angles()[2]
    began_ns = rig.clock.now_ns()
    if abs(angle) > 170.0 and (abs(angle) / rate > 9.0 or abs(angle) > 2000.0):
        with refused("B-INST-008", "nothing was moved"):
            driver.turn(3, angle, rate, 400.0)
        assert rig.moved_deg(began_ns) == 0.0
        return
    driver.turn(3, angle, rate, 400.0)
    assert rig.since_s(began_ns) < 18.0
    rig.clock.sleep(90.0)
    assert driver.in_position()
    assert rig.angles()[2] == pytest.approx(before + angle, abs=1e-9)
    assert rig.moved_deg(began_ns) <= abs(angle) + 1e-6


def test_a_wider_range_takes_three_turns_in_one_demand(rig: TableRig) -> None:
    rig.table.axes[2].range_deg = 7200.0
    driver = rig.ready()
    driver.move(3, 0.0, 45.0)
    began_ns = rig.clock.now_ns()
    driver.turn(3, 1080.0, 270.0, 270.0)
    assert rig.since_s(began_ns) < 4.0
    rig.clock.sleep(8.0)
    assert driver.in_position()
    assert rig.angles()[2] == pytest.approx(1080.0, abs=1e-9)


def test_a_hand_over_that_is_late_is_told_and_the_axis_stopped(rig: TableRig, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = rig.ready()
    write = driver.bus.write

    def held_up(command: str, timeout_s: float) -> None:
        rig.clock.sleep(0.2 * command.startswith(":mode:pos"))
        write(command, timeout_s)

    monkeypatch.setattr(driver.bus, "write", held_up)
    with refused("B-INST-011", "late"):
        driver.turn(3, 1080.0, 270.0, 270.0)
    monkeypatch.undo()
    rig.clock.sleep(5.0)
    assert rig.rates() == [0.0, 0.0, 0.0]


def test_an_axis_that_stands_elsewhere_is_noticed(rig: TableRig) -> None:
    driver = rig.ready()
    rig.world.switches.switch("table_offset", 2, 0.02)
    driver.move(2, 30.0, 45.0)
    rig.clock.sleep(10.0)
    assert rig.angles()[1] == pytest.approx(30.02)
    assert not driver.in_position()
    rig.world.switches.clear()
    rig.clock.sleep(2.0)
    assert driver.in_position()


def test_an_interlock_that_drops_is_told_at_the_next_command_and_needs_a_reset(rig: TableRig) -> None:
    driver = rig.ready()
    driver.move(1, 45.0, 45.0)
    rig.clock.sleep(5.0)
    rig.world.switches.switch("table_interlock")
    assert not driver.in_position()
    with refused("B-INST-005", "interlock fault"):
        driver.stop(3)
    with refused("B-INST-017", "fault"):
        driver.move(1, 0.0, 45.0)
    rig.send(":int:close 1")
    assert rig.ask(":stat:msg? qerror") == "104,INTERLOCK FAULT"
    driver.make_safe()
    driver.close_interlock()
    assert driver.in_position()
