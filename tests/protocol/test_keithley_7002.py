"""Exact exchanges of the switch."""

import pytest
from known_drivers import IDENTIFY, NO_ERROR, after
from scripted import CLEAR, refused, scripted

from bench.model.errors import InputError
from instruments.keithley_7002 import read_closed

START = IDENTIFY["keithley_7002"]
OPENED = [*after(b":OPEN ALL\n"), (b":CLOS:STAT?\n", b"(@)\n")]


@pytest.mark.parametrize(
    ("channel", "polarity", "slot", "crosspoint"),
    [(3, 1, 1, "1!1!3"), (3, -1, 1, "1!2!3"), (10, -1, 4, "4!2!10"), (1, 1, 10, "10!1!1")],
)
def test_route(channel: int, polarity: int, slot: int, crosspoint: str) -> None:
    listed = f"(@{crosspoint})\n".encode()
    script = [*START, *OPENED, *after(b":CLOS " + listed), (b":CLOS:STAT?\n", listed)]
    with scripted("keithley_7002", script, slot=slot) as switch:
        switch.route(channel, polarity)
        assert switch.test_clock.now_ns() == 500_000_000  # twice 250 ms for the relays


def test_a_card_is_one_of_those_that_are_wired() -> None:
    listed = b"(@3!1!2)\n"
    script = [*START, *OPENED, *after(b":CLOS " + listed), (b":CLOS:STAT?\n", listed)]
    with scripted("keithley_7002", script, slot=[1, 3]) as switch:
        switch.route(2, 1, card=3)
    for card in (2, None):
        with scripted("keithley_7002", [], slot=[1, 3]) as switch, refused("B-INST-008"):
            switch.route(2, 1, card=card)


def test_a_relay_that_stays_closed_stops_the_second_route_and_is_not_safe() -> None:
    script = [*START, *after(b":OPEN ALL\n"), (b":CLOS:STAT?\n", b"(@1!2!7)\n")]
    with scripted("keithley_7002", script) as switch, refused("B-INST-015", "1!2!7"):
        switch.route(3, 1)
    script = [*START, (b":OPEN ALL\n", None), NO_ERROR, (b":CLOS:STAT?\n", b"(@1!1!3)\n")]
    with scripted("keithley_7002", script) as switch, refused("B-INST-009"):
        switch.make_safe()


@pytest.mark.parametrize("found", [b"(@)\n", b"(@1!1!3,1!2!3)\n", b"(@1!1!4)\n", b"(@1!1!3:1!1!4)\n"])
def test_anything_but_the_one_route_is_opened_again(found: bytes) -> None:
    script = [*START, *OPENED, *after(b":CLOS (@1!1!3)\n"), (b":CLOS:STAT?\n", found), (b":OPEN ALL\n", None)]
    with scripted("keithley_7002", script) as switch, refused("B-INST-015"):
        switch.route(3, 1)


def test_the_error_queue_is_read_after_each_command() -> None:
    errors = [(b"SYST:ERR?\n", b'-222,"Parameter data out of range"\n'), (b"SYST:ERR?\n", b'-410,"x"\n'), NO_ERROR]
    with (
        scripted("keithley_7002", [*START, *OPENED, (b":CLOS (@1!1!3)\n", None), *errors]) as switch,
        refused("B-INST-005", "-222 Parameter data out of range; -410 x"),
    ):
        switch.route(3, 1)


def test_closed() -> None:
    assert read_closed("(@)") == ()
    assert read_closed("(@ 1!1!3, 1!2!4)") == ("1!1!3", "1!2!4")
    once = [(b":CLOS:STAT?\n", b"ERROR\n"), (CLEAR, None)]
    script = [*START, *once, NO_ERROR, *once, NO_ERROR, *once]
    with scripted("keithley_7002", script) as switch, refused("B-INST-004"):
        switch.closed()


@pytest.mark.parametrize("slot", [0, 11, "one", None])
def test_slots(slot: object) -> None:
    with pytest.raises(InputError, match="slot") as caught, scripted("keithley_7002", [], slot=slot):
        pass
    assert caught.value.code == "B-INST-020"
