"""Every kind of simulated bench shows the same face: made from clock, seed and options; ports, load and truth."""

from __future__ import annotations

from importlib import import_module

import pytest

from bench.model.clock import VirtualClock
from bench.model.installed import offers
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.kinds import checked_options, kind_options, world_class

WORLDS = {offer.name: offer.package for offer in offers("worlds")}


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_is_made_from_clock_seed_and_options(name: str) -> None:
    world = world_class(name)(clock=VirtualClock(), seed=1, options={})  # type: ignore[call-arg]
    start_V, current_A = world.load
    assert all(world.unit.has_port(port) for port in world.ports)
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
    assert checked_options(name, dict.fromkeys(options.OPTIONS, "off")) == dict.fromkeys(options.OPTIONS, False)
