"""Kinds of simulated benches: in which package each lives, what its ``options`` offer, the class of its ``world``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from bench.model.errors import InputError
from bench.model.installed import Offer, offer_of, offers, part
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
    """Return the world of one kind; it is made from (clock, seed, options). Raises: as ``_offer``, and B-PKG-004."""
    kind: type[World] = part(_offer(name), "world", "WORLD")
    return kind


def _offered(name: str) -> _Offered:
    offer = _offer(name)
    return _Offered(*(part(offer, "options", group) for group in ("OPTIONS", "NUMBERS", "TEXTS")))


def _offer(name: str) -> Offer:
    """Return the offer of a kind of world. Raises: InputError B-SIM-001; InstallationError B-PKG-001."""
    offer = offer_of("worlds", name)
    if offer is None:
        known = ", ".join(offer.name for offer in offers("worlds"))
        raise InputError("B-SIM-001", f"no simulated world is called {name!r}", next_step=f"use one of: {known}")
    return offer
