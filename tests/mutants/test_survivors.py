"""How survivors are counted: which tests are near, what is not mutated, the interval of a rate."""

import pytest
from survivors import Mutant, mutants_of, nearest, wilson


def test_tests_that_name_a_driver_come_first_then_those_beside_drivers_and_simulators() -> None:
    tests = {
        "tests/protocol/test_exchanges.py": 'ROWS = ["hp_3458a"]\n',
        "tests/unit/instruments/test_bus.py": "",
        "tests/unit/sim_instruments/test_meter.py": "",
        "tests/unit/sim_instruments/worlds/gnc/test_board.py": "from sim_instruments.worlds.gnc import board\n",
        "tests/unit/run/test_d.py": "from bench.run import stop\n",
    }
    for room in ("instruments", "sim_instruments"):
        order = nearest(Mutant(f"{room}/hp_3458a.py", 3, "core/AddNot", 0), room, tests)
        assert order == [name for name in tests if "/run/" not in name]
    room = "sim_instruments/worlds/gnc"
    order = nearest(Mutant(f"{room}/board.py", 1, "", 0), room, tests)
    assert order == ["tests/unit/sim_instruments/worlds/gnc/test_board.py"]


def test_places_are_mutated_once_each_and_annotations_never() -> None:
    pytest.importorskip("cosmic_ray", reason="needs the extra mutation")
    text = "def f(x: int | None) -> int:\n    return x + 1\n"
    places = mutants_of("f.py", text)
    assert {mutant.line for mutants in places.values() for mutant in mutants} == {2}
    changed = {mutant.text(text) for mutants in places.values() for mutant in mutants}
    assert text.replace("+", "-") in changed
    assert text.replace("1", "2") in changed


def test_the_interval_of_a_rate() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(4, 20) == pytest.approx((0.0807, 0.4160), abs=1e-4)  # Brown, Cai, DasGupta 2001, equation (4)
    assert wilson(0, 20)[0] == 0.0
