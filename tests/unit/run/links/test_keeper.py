"""When a link that was lost counts as back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from run_rig import Rig

from bench.run.links.keeper import keep_links


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
