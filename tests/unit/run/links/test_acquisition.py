"""Acquisition and who looks after its links: order, ticks, stale values, faults of a port; the listener's safety."""

import math
import threading
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import pytest
from run_rig import Listener, Rig

from bench.model.clock import NS, VirtualClock
from bench.model.errors import BenchError, LinkError
from bench.model.events import Disk
from bench.model.installed import unforeseen
from bench.record import RecordError
from bench.run.context import RunContext
from bench.run.links import keeper as link_keeper
from bench.run.links.keeper import keep_links
from bench.run.observers import AtTerminal, Observers, patient
from bench.run.stop import Interruption, StopSwitch, guarded, repeated
from bench.run.watch.environment import PERIOD_S, note_temperatures


def test_links_are_decoded_in_their_order_and_bytes_recorded_before(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    context = rig.context()
    order: list[str] = []
    for name, reader in context.acquisition.readers.items():
        reader.listeners.append(lambda batch, name=name: order.append(f"{name} {len(rig.sink.sent)}"))
    rig.clock.sleep(0.5)
    context.acquisition.refresh()
    assert order == ["port_b 2", "port_a 2"]  # housekeeping first; both links were recorded before


def test_the_recorder_ticks_each_second_of_the_bench_clock(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.context()
    rig.clock.sleep(5.5)
    assert rig.ticks == [NS * second for second in range(1, 6)]


def test_nothing_is_polled_after_the_stop(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    context = rig.context()
    rig.clock.sleep(2.0)
    context.acquisition.stop()
    sent = len(rig.sink.sent)
    rig.clock.sleep(5.0)
    assert len(rig.sink.sent) == sent


def test_wait_until_says_whether_it_happened(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    context = rig.context()
    reader = context.acquisition.readers["port_a"]
    assert context.acquisition.wait_until(lambda: reader.last_counter >= 50, NS)
    assert rig.clock.now_ns() == pytest.approx(0.52 * NS)
    assert not context.acquisition.wait_until(lambda: False, NS)
    assert rig.clock.now_ns() == NS


def test_the_units_temperature_is_the_newest_and_never_stale(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.unit_degC = lambda t_s: round(t_s, 2)
    context = rig.context()
    assert math.isnan(context.unit_temperature_degC)
    rig.clock.sleep(8.0)
    assert context.unit_temperature_degC == pytest.approx(8.0)
    rig.port_b.silent = True
    rig.clock.sleep(9.9)
    assert context.unit_temperature_degC == pytest.approx(8.0)
    rig.clock.sleep(0.2)
    assert math.isnan(context.unit_temperature_degC)


def test_a_port_that_goes_away_is_a_link_error(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    context = rig.context()
    rig.port_a.broken = OSError("device disconnected")
    with pytest.raises(LinkError) as caught:
        context.acquisition.refresh()
    assert (caught.value.code, caught.value.where) == ("B-RUN-024", "port_a")
    rig.clock.sleep(2.0)  # the periodic poll meets it too and keeps it for the next check
    with pytest.raises(LinkError, match="disconnected"):
        rig.stop.check()


def test_a_write_that_fails_is_a_link_error(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    reader = rig.context().acquisition.readers["port_b"]
    rig.port_b.write = lambda sent: (_ for _ in ()).throw(OSError("write timeout"))  # type: ignore[method-assign]
    with pytest.raises(LinkError, match="B-RUN-020"):
        reader.write(b"x")


def kept(rig: Rig, stack: ExitStack) -> RunContext:
    """Links that somebody looks after, in the middle of a campaign."""
    context = rig.context()
    stack.enter_context(keep_links(context))
    rig.clock.sleep(1.0)
    context.acquisition.refresh()
    context.observers.step(rig.step("record", "port_b", seconds=1.0), 0.0)
    return context


def test_a_command_to_a_unit_that_is_gone_waits_for_it(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    with ExitStack() as stack:
        context = kept(rig, stack)
        rig.port_b.read = rig.port_b.write = refuse  # type: ignore[assignment]
        with pytest.raises(Interruption) as caught:
            context.acquisition.readers["port_b"].write(b"x")
    assert (caught.value.wish.kind, caught.value.wish.by) == ("hold", "link port_b")
    assert "not here" in caught.value.wish.reason


def refuse(_: object) -> NoReturn:
    raise OSError("not here")


def test_errors_the_kernel_counts_are_events(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path)
    counts = {"frame": 2, "overrun": 0, "parity": 0, "buf_overrun": 1}
    counting = {id(rig.port_a): counts}
    monkeypatch.setattr(link_keeper, "kernel_counts", lambda link: dict(counting.get(id(link), {})) or None)
    with ExitStack() as stack:
        context = kept(rig, stack)
        rig.clock.sleep(10.0)
        assert rig.events("link") == []
        counts["overrun"], counts["buf_overrun"] = 3, 2
        context.acquisition.readers["port_a"].behind = 2
        rig.clock.sleep(20.0)
    overrun, behind = rig.events("link")
    assert overrun == {
        "link": "port_a", "state": "kernel errors", "frame": 0, "overrun": 3, "parity": 0, "buf_overrun": 1
    }  # fmt: skip
    assert behind == {"link": "port_a", "state": "behind", "times": 2}


def test_a_run_that_is_over_waits_for_nothing(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    with ExitStack() as stack:
        kept(rig, stack)
        rig.stop.shield()
        rig.port_a.dropped = lambda counter: True
        rig.port_b.silent = True
        rig.clock.sleep(20.0)
        assert rig.stop.holds.reasons == {}
        assert rig.port_b.written == b""
    assert rig.events("link") == []


def test_the_first_fault_beside_the_steps_counts() -> None:
    stop = StopSwitch()
    for fault in (RecordError("B-REC-003", "full"), ValueError("later")):
        guarded(lambda fault=fault: (_ for _ in ()).throw(fault), stop)()  # type: ignore[misc]
    with pytest.raises(RecordError, match="full"):
        stop.check()


def test_an_unforeseen_error_names_its_place() -> None:
    try:
        Path("/nonexistent/file").read_text()
    except OSError as error:
        found = unforeseen(error)
    assert found.code == "B-INT-001"
    assert "FileNotFoundError" in found.message
    assert unforeseen(ValueError("two\nlines")).message == "ValueError: two lines"


def test_the_environment_is_written_each_minute_and_never_raises(tmp_path: Path) -> None:
    rig = Rig(tmp_path, "chamber")
    context = rig.context()
    rig.air_degC, rig.unit_degC = (lambda t_s: t_s / 60.0), (lambda t_s: 30.0)
    with repeated(rig.clock, context.stop, (PERIOD_S, partial(note_temperatures, context))):
        rig.clock.sleep(60.0)
        with context.in_use.take("chamber"):  # a step talks to it
            rig.clock.sleep(60.0)
        rig.instruments["chamber"].fail["measure_air"] = LinkError("B-INST-001", "x")
    rig.clock.sleep(60.0)
    assert rig.events("environment") == [
        {"air_degC": 1.0, "unit_degC": 30.0},
        {"air_degC": None, "unit_degC": 30.0},
    ]


class Broken:
    def __init__(self, error: BaseException) -> None:
        self.error, self.asked = error, 0

    def message(self, text: str) -> None:
        self.asked += 1
        raise self.error

    step = record = message


@pytest.mark.parametrize("error", [BrokenPipeError(), OSError(5, "input/output error"), SystemExit(1)])
def test_a_listener_that_is_gone_is_not_asked_again(error: BaseException) -> None:
    broken = Broken(error)
    said = Listener()
    observers = Observers(VirtualClock(), AtTerminal(broken), AtTerminal(said))  # type: ignore[arg-type]
    observers.message("one")
    observers.message("two")
    assert broken.asked == 1
    assert said.messages == ["one", "two"]


def test_patience_with_a_disk() -> None:
    said: list[Disk] = []
    fault: list[BenchError | None] = []

    def write(_: int) -> None:
        if (error := fault.pop(0)) is not None:
            raise error

    full, over = RecordError("B-REC-001", "full"), RecordError("B-REC-003", "64 MB wait")
    fault += [None, full, full, None, full, over]
    tick = patient(write, said.append)
    for second in range(5):
        tick(second)
    assert len(said) == 2  # once per trouble
    with pytest.raises(RecordError, match="64 MB"):
        tick(5)


def test_nothing_is_stamped_between_the_last_bytes_that_count_and_the_event(tmp_path: Path) -> None:
    """A replay goes by the stamps: a thread that reads in between would change what it takes for the record."""
    rig = Rig(tmp_path)
    acquisition = rig.context().acquisition
    reader = next(iter(acquisition.readers.values()))
    rig.clock.sleep(1.0)
    done = threading.Event()

    def read() -> None:
        reader.receive()
        done.set()

    with acquisition.at_rest():
        before = reader.last_byte_ns
        other = threading.Thread(target=read, daemon=True)
        other.start()
        assert not done.wait(0.2)
        assert reader.last_byte_ns == before
    assert done.wait(5.0)


def test_a_port_that_is_back_without_frames_is_not_back(tmp_path: Path) -> None:
    """Its newest frame is not old yet when the port opens again; it says nothing of now."""
    rig = Rig(tmp_path)
    record = rig.step("record", "port_a", seconds=100.0)
    context = rig.context()
    port: Any = rig.port_a
    port.reopen = lambda: setattr(port, "broken", None)
    with keep_links(context) as keeper:
        rig.clock.sleep(5.05)
        keeper.step(record, 0.0)
        port.broken, port.dropped = OSError("gone"), lambda counter: True
        context.acquisition.catch_up()
        keeper.service()
        assert list(context.stop.holds.reasons) == ["link port_a"]
        for _ in range(3):
            rig.clock.sleep(0.3)
            keeper.service()
            assert list(context.stop.holds.reasons) == ["link port_a"]
        port.dropped = lambda counter: False
        rig.clock.sleep(0.3)
        keeper.service()
        assert context.stop.holds.reasons == {}


def test_what_a_person_switches_on_and_off_is_missed_only_while_it_is_on(tmp_path: Path) -> None:
    """A radar: one flight after the other would stand still for it for ever."""
    rig = Rig(tmp_path)
    prompt = rig.step("prompt", text="radar", sets={"radar": "on"})
    record = rig.step("record", "port_a", seconds=100.0)
    context = rig.context()
    port: Any = rig.port_a
    port.dropped = lambda counter: True  # nothing is sent before somebody switches it on

    def silent_after_s(seconds: float) -> bool:
        rig.clock.sleep(seconds)
        context.acquisition.catch_up()
        keeper.service()
        return bool(context.stop.holds.reasons)

    with keep_links(context) as keeper:
        rig.clock.sleep(1.0)
        keeper.step(prompt, 0.0)
        port.dropped = lambda counter: False
        keeper.step(record, 0.0)
        assert not silent_after_s(5.0)
        keeper.step(prompt, 0.0)
        port.dropped = lambda counter: True
        keeper.step(record, 0.0)
        assert not silent_after_s(5.0)
        keeper.step(prompt, 0.0)
        port.dropped = lambda counter: False
        keeper.step(record, 0.0)
        assert not silent_after_s(5.0)
        port.dropped = lambda counter: True
        assert silent_after_s(5.0)
