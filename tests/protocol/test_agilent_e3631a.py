"""Exact exchanges of the auxiliary supply."""

import threading

import pytest
from known_drivers import IDENTIFY, after
from scripted import make, refused, scripted

START = IDENTIFY["agilent_e3631a"]
RAIL_3 = [*after(b"INST:NSEL 3\n"), *after(b"CURR 5.0E-01\n"), *after(b"VOLT -1.5E+01\n")]
CONFIGURED = [*START, *RAIL_3, (b"CURR?\n", b"+5.00000000E-01\n"), (b"VOLT?\n", b"-1.50000000E+01\n")]


def test_rails() -> None:
    measured = [*after(b"INST:NSEL 2\n"), (b"MEAS:VOLT?\n", b"+1.50012000E+01\n")]
    nought = [*after(b"VOLT 0\n"), (b"VOLT?\n", b"+0.00000000E+00\n")]
    others = [*after(b"INST:NSEL 1\n"), *nought, *after(b"INST:NSEL 2\n"), *nought]
    on = [*others, *after(b"INST:NSEL 3\n"), *CONFIGURED[-2:], *after(b"OUTP ON\n"), (b"OUTP?\n", b"1\n")]
    with scripted("agilent_e3631a", [*CONFIGURED, *on, *measured]) as supply:
        supply.configure(3, -15.0, 0.5)
        supply.output_on()
        assert supply.measure_voltage(2) == 15.0012


@pytest.mark.parametrize(
    ("rail", "voltage", "limit"), [(1, 6.19, 1.0), (1, -0.1, 1.0), (2, 15.0, 1.04), (3, 15.0, 0.5), (2, -15.0, 0.5)]
)
def test_limits_of_each_rail(rail: int, voltage: float, limit: float) -> None:
    with scripted("agilent_e3631a", []) as supply, refused("B-INST-008", f"rail {rail} takes"):
        supply.configure(rail, voltage, limit)


def test_an_unset_rail_and_a_lost_set_point_are_noticed() -> None:
    with scripted("agilent_e3631a", []) as supply, refused("B-INST-010"):
        supply.output_on()
    with scripted("agilent_e3631a", [*CONFIGURED[:-1], (b"VOLT?\n", b"-1.20000000E+01\n")]) as supply:
        with refused("B-INST-011"):
            supply.configure(3, -15.0, 0.5)
        assert not supply.configured


def test_two_threads_never_measure_the_wrong_rail() -> None:
    """The rail selected by one thread is still selected when it reads."""
    supply = make("agilent_e3631a", START)
    supply.identify()
    pause = threading.Event()
    state = {"rail": 0, "reply": ""}

    def write(command: str) -> None:
        pause.wait(2e-4)  # lets the other threads try
        if command.startswith("INST:NSEL "):
            state["rail"] = int(command[-1])
        state["reply"] = f"{state['rail']}.0" if command == "MEAS:VOLT?" else '+0,"No error"'

    supply.test_resource.write = write
    supply.test_resource.read = lambda: state["reply"]
    wrong: list[float] = []

    def measure(rail: int) -> None:
        wrong.extend(found for _ in range(20) if (found := supply.measure_voltage(rail)) != rail)

    threads = [threading.Thread(target=measure, args=(rail,)) for rail in (1, 2, 3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
