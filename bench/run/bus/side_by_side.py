"""Questions to every instrument of a bench: one after the other on a bus, different buses side by side.

Under the virtual clock all are asked one after the other, so that a rehearsal is the same each time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from bench.model.clock import Clock

T = TypeVar("T")
MOST_BUSES = 32


def asked(resources: Mapping[str, str], ask: Callable[[str], T], clock: Clock) -> dict[str, T]:
    """Return what ``ask`` says of each role, in the order of the roles.

    Args:   resources: VISA address by role.   ask: must not raise, for nothing of it would be heard then.
    """
    if clock.virtual:
        return {role: ask(role) for role in resources}
    buses: dict[str, list[str]] = {}
    for role, resource in resources.items():
        buses.setdefault(bus_of(resource), []).append(role)

    def ask_bus(roles: list[str]) -> list[tuple[str, T]]:
        return [(role, ask(role)) for role in roles]

    with ThreadPoolExecutor(min(len(buses), MOST_BUSES) or 1) as threads:
        found = dict(pair for pairs in threads.map(ask_bus, buses.values()) for pair in pairs)
    return {role: found[role] for role in resources}


def bus_of(resource: str) -> str:
    """Return what only one can talk on at a time: a GPIB board as a whole, anything else by its address."""
    name = resource.upper()
    return name.split("::", maxsplit=1)[0] if name.startswith("GPIB") else name
