"""Kinds of simulated benches: in which package each lives, what its ``options`` offer, the class of its ``world``."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from bench.model.installed import offers
from sim_instruments.worlds.common.options import Check, number_of, switch_of, text_of, unknown_option
from sim_instruments.worlds.common.world import World


class _Offered(NamedTuple):
    switches: Mapping[str, str]
    numbers: Mapping[str, tuple[str, float, float]]  # text, least, most
    texts: Mapping[str, tuple[str, Sequence[str] | Check]]  # text, what is possible


def kind_options(name: str) -> tuple[str, ...]:
    """Return the names of all options of a kind of world."""
    offered = _offered(name)
    return (*offered.switches, *offered.numbers, *offered.texts)


def checked_options(name: str, options: Mapping[str, str]) -> dict[str, Any]:
    """Return the options as the world takes them, only those that are given. Raises: InputError B-SIM-002."""
    offered = _offered(name)
    checked: dict[str, Any] = {}
    for key, value in options.items():
        if key in offered.switches:
            checked[key] = switch_of(key, value)
        elif key in offered.numbers:
            checked[key] = number_of(key, value, *offered.numbers[key][1:])
        elif key in offered.texts:
            checked[key] = text_of(key, value, offered.texts[key][1])
        else:
            raise unknown_option(key, kind_options(name))
    return checked


def world_class(name: str) -> type[World]:
    """Return the world of one kind; it is made from (clock, seed, options)."""
    kind: type[World] = importlib.import_module(f"{offers('worlds')[name].package}.world").WORLD
    return kind


def _offered(name: str) -> _Offered:
    module = importlib.import_module(f"{offers('worlds')[name].package}.options")
    return _Offered(*(getattr(module, group) for group in ("OPTIONS", "NUMBERS", "TEXTS")))
