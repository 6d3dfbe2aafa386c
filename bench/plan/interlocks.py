"""The interlocks of a plan: those of its station, and those of the sequence, which win where the names are equal."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from bench.model.yamlio import Document
from bench.plan.findings import Findings
from bench.plan.language.interlocks import OF_UNIT, SIGNALS, Interlock, InterlockRule, rule_of
from bench.plan.station import Station

_KEY = "interlocks"


def station_rules(station: Station, findings: Findings) -> dict[str, InterlockRule]:
    """Rules of a station by name; mistakes are noted."""
    return _rules(station.file.interlocks, station.document, station, findings)


def plan_rules(
    entries: Mapping[str, Interlock], document: Document[Any], station: Station, findings: Findings
) -> tuple[InterlockRule, ...]:
    """Rules of a sequence on its station, in order of their names. Mistakes of the station are noted by its own check.

    A rule of the station for what the sequence's links do not tell is left out; one of the sequence is a mistake.
    Args:      entries: the section ``interlocks`` of the sequence.   document: where it was read from.
    Findings:  B-PLAN-097 (a signal that comes over a link which the sequence does not name).
    """
    links = document.model.frame
    own = _rules(entries, document, station, findings)
    for rule in own.values():
        if not _is_told(rule, links):
            message = f"interlock {rule.name}: {rule.signal} comes over a link, and the sequence does not name it"
            findings.add("B-PLAN-097", rule.where, message, "name the link under 'frame', or take the interlock out")
    rules = {**station_rules(station, Findings()), **own}
    return tuple(rules[name] for name in sorted(rules) if _is_told(rules[name], links))


def _is_told(rule: InterlockRule, links: Collection[str]) -> bool:
    """Return whether something will tell the signal of a rule: an instrument, or one of the sequence's links."""
    if SIGNALS[rule.signal].of == "link":
        return rule.of in links
    return bool(links) or rule.signal not in OF_UNIT


def _rules(
    entries: Mapping[str, Interlock], document: Document[Any], station: Station, findings: Findings
) -> dict[str, InterlockRule]:
    made = {
        name: rule_of(name, entry, _place(document, name), station.links, station.instruments, findings)
        for name, entry in entries.items()
    }
    return {name: rule for name, rule in made.items() if rule is not None}


def _place(document: Document[Any], name: str) -> Callable[[str], str]:
    return lambda key: document.where((_KEY, name, key))
