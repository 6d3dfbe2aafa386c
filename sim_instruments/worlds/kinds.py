"""Worlds that are found by their kind: what each offers in its ``options``, and how its ``world`` is opened."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, NamedTuple

from bench.model.clock import Clock
from bench.model.installed import offers
from sim_instruments.worlds.common.options import number_of, switch_of, unknown_option, word_of
from sim_instruments.worlds.common.world import World


class _Offered(NamedTuple):
    switches: Mapping[str, str]
    numbers: Mapping[str, tuple[str, float, float]]  # text, least, most
    words: Mapping[str, tuple[str, tuple[str, ...]]]  # text, choices


def kind_options(kind: str) -> tuple[str, ...]:
    """Names of all options of the worlds of one kind, such as "fog_north"."""
    offered = _offered(kind)
    return (*offered.switches, *offered.numbers, *offered.words)


def checked_options(kind: str, options: Mapping[str, str]) -> dict[str, Any]:
    """Options as the world takes them, only those that are given. Raises: InputError B-SIM-002."""
    offered = _offered(kind)
    found: dict[str, Any] = {}
    for key, value in options.items():
        if key in offered.switches:
            found[key] = switch_of(key, value)
        elif key in offered.numbers:
            found[key] = number_of(key, value, *offered.numbers[key][1:])
        elif key in offered.words:
            found[key] = word_of(key, value, offered.words[key][1])
        else:
            raise unknown_option(key, kind_options(kind))
    return found


def world_class(kind: str) -> type[World]:
    """The world of one kind."""
    module = importlib.import_module(f"{_package(kind)}.world")
    found: type[World] = module.WORLD
    return found


def kind_world(kind: str, clock: Clock, seed: int, options: Mapping[str, str]) -> World:
    """Open a world of one kind. Raises: InputError B-SIM-002."""
    make: Any = world_class(kind)
    world: World = make(clock=clock, seed=seed, options=checked_options(kind, options))
    return world


def _package(kind: str) -> str:
    return offers("worlds")[kind].package


def _offered(kind: str) -> _Offered:
    module = importlib.import_module(f"{_package(kind)}.options")
    return _Offered(*(getattr(module, group) for group in ("OPTIONS", "NUMBERS", "TEXTS")))
