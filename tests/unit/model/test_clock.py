"""The two clocks behind one interface."""

from __future__ import annotations

import threading

import pytest

from bench.model.clock import NS, VIRTUAL_START_UTC_NS, VirtualClock, WallClock, to_ns


def test_virtual_time_jumps_and_utc_follows() -> None:
    clock = VirtualClock()
    clock.sleep(136_800.0)
    assert clock.now_ns() == 136_800 * NS
    assert clock.utc_ns() == VIRTUAL_START_UTC_NS + 136_800 * NS
    clock.sleep_until_ns(5)
    assert clock.now_ns() == 136_800 * NS


def test_callbacks_run_in_order_of_due_time_then_registration() -> None:
    clock = VirtualClock()
    seen: list[tuple[str, int]] = []
    clock.every(2.0, lambda: seen.append(("a", clock.now_ns() // NS)))
    clock.every(1.0, lambda: seen.append(("b", clock.now_ns() // NS)))
    clock.sleep(4.0)
    assert seen == [("b", 1), ("a", 2), ("b", 2), ("b", 3), ("a", 4), ("b", 4)]


def test_a_cancelled_callback_never_runs_again() -> None:
    clock = VirtualClock()
    seen: list[int] = []
    task = clock.every(1.0, lambda: (seen.append(clock.now_ns() // NS), task.cancel() if len(seen) == 2 else None))
    clock.sleep(10.0)
    assert seen == [1, 2]


def test_a_callback_that_sleeps_is_not_entered_again_and_drops_missed_ticks() -> None:
    clock = VirtualClock()
    seen: list[int] = []

    def slow() -> None:
        seen.append(clock.now_ns() // NS)
        clock.sleep(2.5)

    clock.every(1.0, slow)
    clock.sleep(10.0)
    assert seen == [1, 4, 7, 10]


def test_an_error_in_a_callback_reaches_the_sleeper_and_leaves_the_clock_usable() -> None:
    clock = VirtualClock()
    task = clock.every(1.0, lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        clock.sleep(5.0)
    task.cancel()
    assert clock.now_ns() == NS
    clock.sleep(1.0)
    assert clock.now_ns() == 2 * NS


def test_quiet_time_ends_at_the_sleeper_or_the_next_callback_that_may_change_the_bench() -> None:
    clock = VirtualClock()
    horizons: list[float] = []
    clock.every(1.0, lambda: horizons.append(clock.quiet_until_ns() / NS), observer=True)
    clock.sleep(2.0)
    clock.every(2.5, lambda: None, observer=False)
    clock.sleep(4.0)
    assert horizons == [2.0, 2.0, 4.5, 4.5, 6.0, 6.0]


def test_two_virtual_runs_are_identical() -> None:
    def run() -> list[int]:
        clock = VirtualClock()
        seen: list[int] = []
        for period in (0.1, 0.3, 0.7):
            clock.every(period, lambda: seen.append(clock.now_ns()))
        clock.sleep(10.0)
        return seen

    assert run() == run()
    assert len(run()) == 100 + 33 + 14


@pytest.mark.parametrize("clock", [VirtualClock(), WallClock()])
def test_a_period_must_be_positive(clock: VirtualClock | WallClock) -> None:
    with pytest.raises(ValueError, match="not positive"):
        clock.every(0.0, lambda: None)


def test_wall_clock_sleeps_at_least_as_long_as_asked() -> None:
    clock = WallClock()
    start = clock.now_ns()
    clock.sleep_until_ns(start + 20_000_000)
    clock.sleep(0.01)
    assert clock.now_ns() - start >= 30_000_000
    assert abs(clock.utc_ns() / NS - 1.7e9) < 1e9


def test_wall_clock_calls_back_on_its_own_thread_until_cancelled() -> None:
    clock = WallClock()
    called = threading.Semaphore(0)
    threads = set()
    task = clock.every(0.005, lambda: (threads.add(threading.current_thread()), called.release()))
    assert all(called.acquire(timeout=5.0) for _ in range(3))
    task.cancel()
    assert threading.main_thread() not in threads
    assert not any(thread.is_alive() for thread in threads)


def test_seconds_are_rounded_to_the_nearest_nanosecond() -> None:
    assert to_ns(0.1) == 100_000_000
    assert to_ns(1e-9 * 1.6) == 2


def test_an_error_on_a_thread_of_the_wall_clock_reaches_the_main_thread() -> None:
    clock = WallClock()
    called = threading.Event()
    calls: list[int] = []

    def fail() -> None:
        calls.append(1)
        called.set()
        raise OSError("gone")

    ticking = clock.every(0.005, fail)
    assert called.wait(5.0)
    with pytest.raises(OSError, match="gone"):
        clock.sleep(0.05)
    clock.sleep(0.03)
    ticking.cancel()
    assert calls == [1]


def test_turns_ahead_are_those_before_anybody_else_acts() -> None:
    clock = VirtualClock()
    ahead: list[list[float]] = []
    clock.every(2.0, lambda: None)  # registered first: at the same time its turn comes first
    clock.every(1.0, lambda: ahead.append([turn / NS for turn in clock.turns_ahead_ns()]))
    clock.every(3.0, lambda: None)
    clock.sleep(5.0)
    assert ahead == [[], [3.0], [], [5.0], []]


def test_turns_that_were_passed_are_not_taken_again() -> None:
    clock = VirtualClock()
    taken: list[tuple[str, float]] = []

    def turn() -> None:
        taken.append(("first", clock.now_ns() / NS))
        for due_ns in clock.turns_ahead_ns():
            clock.pass_to_ns(due_ns)

    clock.every(1.0, turn)
    clock.every(4.0, lambda: taken.append(("other", clock.now_ns() / NS)))
    clock.sleep(9.0)
    assert taken == [("first", 1.0), ("other", 4.0), ("first", 5.0), ("other", 8.0), ("first", 9.0)]
    assert clock.now_ns() == 9 * NS
