"""Groups a campaign promises and has no result for."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

from bench.model.errors import FitError
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.group_fit import reasons
from bench.systems.af_converter.groups import Group, Place, place_name, place_of

if TYPE_CHECKING:
    from bench.record import RecordRow


def missing_groups(
    rows: Iterable[RecordRow],
    done: Collection[Place],
    refused: Iterable[tuple[Group, FitError]],
    campaign: Campaign,
) -> list[str]:
    """Return every promised channel and temperature without scale-factor errors, with the reason; one sentence each.

    Promised are all places the records name, and every declared channel at every temperature any record names.
    A channel without any record is named once.
    """
    taken = {place_of(row.window.conditions): None for row in rows}
    reason = {group.place: f"{error.message} ({error.code}){_left_out(group)}" for group, error in refused}
    recorded = {channel for channel, _, _ in taken}
    places: dict[Place, None] = dict(taken)
    for temperature_degC in dict.fromkeys(at for _, at, _ in taken):
        places |= {(one.number, temperature_degC, 0): None for one in campaign.channels if one.number in recorded}
    found = [f"{place_name(place)}: {reason.get(place, 'no record')}" for place in sorted(places) if place not in done]
    return found + [f"channel {one.number}: no record" for one in campaign.channels if one.number not in recorded]


def _left_out(group: Group) -> str:
    return f"; left out: {reasons(group)}" if group.left_out and group.closed.gate_s.size else ""
