"""Every kind of simulated bench shows the same face: made from clock, seed and options; ports, load, acts and truth."""

import zlib
from importlib import import_module

import numpy as np
import pytest

from bench.model.clock import VirtualClock
from bench.model.errors import InputError
from bench.model.installed import offers
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.simulation import (
    check_operation,
    checked_options,
    kind_options,
    open_world,
    world_class,
)

WORLDS = {offer.name: offer.package for offer in offers("worlds")}
ALONE = {"instruments": {}}  # a station without instruments
WRONG_OPTIONS = [
    ("gnc_module", "hysteresis", "on"),
    ("gnc_module", "noise", "yes"),
    ("gnc_module", "tilt_arcmin", "61"),
    ("gnc_module", "tilt_arcmin", "-1"),
    ("gnc_module", "faults", "GNC-01"),
    ("gnc_module", "faults", "GNC-01="),
    ("gnc_module", "faults", "=cpu_carry"),
    ("gnc_module", "faults", "GNC-01=cpu_cary"),
    ("gnc_module", "faults", "GNC-01=cpu_carry+"),
    ("ring_laser", "beat_noise_ppm", "-1"),
    ("fog_north", "scale_V", "11"),
    ("fog_north", "parameters", "wild"),
    ("time_sync", "offset_s", "2"),
    ("time_sync", "drift_ppm", "nan"),
    *[("af_converter", "time_constants", value) for value in ("0", "0.5", "1001", "nan", "on")],
]
NO_SUCH_ACT, NO_SUCH_VALUE = "B-SIM-018", "B-SIM-019"
WRONG_ACTS = [
    ("af_converter", "unit", "X", NO_SUCH_ACT),
    ("gnc_module", "chamber", 1, NO_SUCH_ACT),
    ("gnc_module", "unit", "", NO_SUCH_VALUE),
    ("gnc_module", "unit", "x" * 13, NO_SUCH_VALUE),
    ("gnc_module", "unit", "Größe", NO_SUCH_VALUE),
    ("gnc_module", "dip_switch", 6, NO_SUCH_VALUE),
    ("gnc_module", "dip_switch", "1.5", NO_SUCH_VALUE),
    ("gnc_module", "mounting", "w", NO_SUCH_VALUE),
    ("gnc_module", "table", "wood", NO_SUCH_VALUE),
    ("ring_laser", "path_length", 0.01, NO_SUCH_VALUE),
    ("ring_laser", "path_length", "28 cm", NO_SUCH_VALUE),
    ("ring_laser", "path_length", None, NO_SUCH_VALUE),
    ("ring_laser", "backscatter_phase", 361, NO_SUCH_VALUE),
    ("ring_laser", "backscatter_phase", "nan", NO_SUCH_VALUE),
    ("fog_north", "place", "roof", NO_SUCH_VALUE),
    ("fog_north", "head", "north", NO_SUCH_VALUE),
    ("fog_north", "head", 361.0, NO_SUCH_VALUE),
    ("fog_north", "head", float("nan"), NO_SUCH_VALUE),
    ("fog_north", "head", None, NO_SUCH_VALUE),
    ("time_sync", "speed", -1.0, NO_SUCH_VALUE),
    ("time_sync", "speed", "fast", NO_SUCH_VALUE),
    ("time_sync", "speed", 401.0, NO_SUCH_VALUE),
    ("time_sync", "speed", "100 m", NO_SUCH_VALUE),
    ("time_sync", "acceleration", 51.0, NO_SUCH_VALUE),
    ("time_sync", "acceleration", None, NO_SUCH_VALUE),
    ("time_sync", "radar", True, NO_SUCH_VALUE),
    ("time_sync", "radar", "of", NO_SUCH_VALUE),
]


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_is_made_from_clock_seed_and_options(name: str) -> None:
    world = world_class(name)(clock=VirtualClock(), seed=1, options={})  # type: ignore[call-arg]
    start_V, current_A = world.load
    assert all(world.unit.port_at(port) for port in world.ports)
    assert start_V > 1.0
    assert 0.1 < current_A < 5.0
    assert type(world).truth is not World.truth
    world.close()


@pytest.mark.parametrize("name", WORLDS)
def test_every_option_says_what_it_is(name: str) -> None:
    options = import_module(f"{WORLDS[name]}.options")
    told = [*options.OPTIONS.values(), *(entry[0] for entry in (*options.NUMBERS.values(), *options.TEXTS.values()))]
    assert len(told) == len(kind_options(name))
    assert all(told)
    assert set(kind_options(name)) == {*options.OPTIONS, *options.NUMBERS, *options.TEXTS}
    assert checked_options(name, dict.fromkeys(options.OPTIONS, "off")) == dict.fromkeys(options.OPTIONS, False)


@pytest.mark.parametrize(("name", "option", "value"), WRONG_OPTIONS)
def test_an_option_that_cannot_be_is_refused(name: str, option: str, value: str) -> None:
    with pytest.raises(InputError) as caught:
        open_world(name, clock=VirtualClock(), seed=1, station=ALONE, options={option: value})
    assert caught.value.code == "B-SIM-002"
    assert option in str(caught.value)


@pytest.mark.parametrize(("name", "act", "value", "code"), WRONG_ACTS)
def test_what_a_person_cannot_do_is_refused(name: str, act: str, value: object, code: str) -> None:
    """At the bench, and before there is one."""
    world = open_world(name, clock=VirtualClock(), seed=1, station=ALONE)
    for operate in (world.operate, lambda act, value: check_operation(name, act, value)):
        with pytest.raises(InputError) as caught:
            operate(act, value)
        assert caught.value.code == code
        assert act in str(caught.value)
    world.close()


@pytest.mark.parametrize("numbers", [(0,), (1, 0, 7), (2**32 - 1, 3), (2**32, 3), (2**70, 2**33, 0)])
def test_draws_are_those_of_the_list_of_numbers(numbers: tuple[int, ...]) -> None:
    """Named by seed and purpose, whatever size the numbers are."""
    expected = np.random.default_rng([numbers[0], zlib.crc32(b"a purpose"), *numbers[1:]]).standard_normal(3)
    np.testing.assert_array_equal(generator(numbers[0], "a purpose", *numbers[1:]).standard_normal(3), expected)
