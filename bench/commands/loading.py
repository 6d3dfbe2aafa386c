"""From the words of the command line to a checked plan."""

from __future__ import annotations

from collections.abc import Sequence

from bench.model.errors import InputError, InputErrors
from bench.model.shipped import find_shipped
from bench.plan import Plan, check_plan, compile_sequence, load_station


def settings_of(pairs: Sequence[str]) -> dict[str, str]:
    """``["key=value"]`` as a dictionary. Raises InputError B-CLI-001."""
    settings = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise InputError(
                "B-CLI-001", f"{pair!r} is not KEY=VALUE", where="--set", next_step="for example --set dwell='10 s'"
            )
        settings[key.strip()] = value.strip()
    return settings


def checked_plan(sequence: str, station: str | None, settings: Sequence[str]) -> Plan:
    """Compile and check a sequence. Raises InputErrors with every mistake."""
    bench = None if station is None else load_station(find_shipped("stations", station))
    plan = compile_sequence(find_shipped("sequences", sequence), bench, settings_of(settings))
    if mistakes := check_plan(plan, plan.station):
        raise InputErrors(mistakes)
    return plan
