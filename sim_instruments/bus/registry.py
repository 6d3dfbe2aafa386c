"""Live worlds by id: how the VISA backend and the serial handler find the world that was opened for them.

Ids are handed out in order and name a world inside this process only; they never reach a record or a report.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim_instruments.worlds.common.world import World

_worlds: dict[str, World] = {}
_last = 0


def add(world: World) -> str:
    """Register a world and return its id."""
    global _last  # noqa: PLW0603 - one counter per process is the point
    _last += 1
    _worlds[f"w{_last}"] = world
    return f"w{_last}"


def find(world_id: str) -> World | None:
    """The live world with this id, None if there is none (any more)."""
    return _worlds.get(world_id)


def remove(world_id: str) -> None:
    """Forget a world; unknown ids are ignored."""
    _worlds.pop(world_id, None)
