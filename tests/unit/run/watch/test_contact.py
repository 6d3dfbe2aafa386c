"""What is on is asked whether it is there: one that does not answer any more holds the run, and nothing else does."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from run_rig import Rig

from bench.model.clock import NS
from bench.model.errors import InstrumentError
from bench.model.ports import Effect, action
from bench.run.watch.outputs import CONTACT_S, CONTACT_WAKE_S, LOST_S, Contact


class Calibrator:
    """Answers, until it is gone."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self.gone, self.asked = rig, False, 0
        self._heard_ns, self._silent_ns = rig.clock.now_ns(), -1

    @action(effect=Effect.STIMULUS_ON)
    def operate(self) -> None:
        """Switch on."""

    def look(self) -> None:
        self.asked += 1
        if self.gone:
            self._silent_ns = self._rig.clock.now_ns() if self._silent_ns < 0 else self._silent_ns
            raise InstrumentError("B-INST-003", "nobody there")
        self._heard_ns, self._silent_ns = self._rig.clock.now_ns(), -1

    def heard_s(self) -> float:
        return (self._rig.clock.now_ns() - self._heard_ns) / NS

    def silence_s(self) -> float:
        return 0.0 if self._silent_ns < 0 else (self._rig.clock.now_ns() - self._silent_ns) / NS


@pytest.fixture
def watched(tmp_path: Path) -> tuple[Rig, Calibrator, Any, Contact]:
    rig = Rig(tmp_path)
    calibrator: Any = Calibrator(rig)
    rig.instruments = {"calibrator": calibrator}
    context = rig.context()
    entry = SimpleNamespace(driver="fluke_5720a", resource="TCPIP0::a::hislip0::INSTR")
    context.plan.station = SimpleNamespace(instruments={"calibrator": entry})  # type: ignore[misc]
    contact = Contact(context)
    rig.clock.every(CONTACT_WAKE_S, contact.take)
    return rig, calibrator, context, contact


def on(contact: Contact, reply: str) -> None:
    contact.traffic("calibrator", "tx", "ISR?", 0)
    contact.traffic("calibrator", "rx", reply, 0)


def test_one_that_is_on_and_gone_holds_the_run_in_time(watched: tuple[Rig, Calibrator, Any, Contact]) -> None:
    rig, calibrator, context, contact = watched
    on(contact, "4097")
    rig.clock.sleep(10.0)
    assert 8 <= calibrator.asked <= 10
    assert context.stop.holds.reasons == {}
    calibrator.gone = True
    lost_ns = rig.clock.now_ns()
    while not context.stop.holds.reasons:
        rig.clock.sleep(0.05)
    assert (rig.clock.now_ns() - lost_ns) / NS <= CONTACT_S + LOST_S + 3 * CONTACT_WAKE_S
    assert set(context.stop.holds.reasons) == {"instrument calibrator"}
    assert context.away == {"calibrator"}


def test_a_glitch_is_none_of_its_business(watched: tuple[Rig, Calibrator, Any, Contact]) -> None:
    rig, calibrator, context, contact = watched
    on(contact, "4097")
    rig.clock.sleep(5.0)
    calibrator.gone = True
    rig.clock.sleep(CONTACT_S + 0.5)
    calibrator.gone = False
    rig.clock.sleep(5.0)
    assert context.stop.holds.reasons == {}


@pytest.mark.parametrize("why", ["off", "in use", "over"])
def test_nobody_else_is_asked(watched: tuple[Rig, Calibrator, Any, Contact], why: str) -> None:
    rig, calibrator, context, contact = watched
    on(contact, "4096" if why == "off" else "4097")
    if why == "over":
        context.stop.shield()
    with context.in_use.take("calibrator" if why == "in use" else "dmm"):
        rig.clock.sleep(10.0)
    assert calibrator.asked == 0
