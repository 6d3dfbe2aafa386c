"""What no data of a campaign can show, by name: the assumption, the size that passes unseen, and what would show it.

An effect that changes every reading as the wanted quantity would leaves no residual. No evidence is possible, so it is
said, before the campaign by ``bench check`` and after it in results.json and the report.

Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from bench.model.systems import declared_by, named


@dataclass(frozen=True)
class Assumption:
    """One thing that is taken for granted, in short sentences with numbers and units.

    ``unseen``: size that leaves no trace in this campaign.   ``effect``: what it does to which number.   ``shown_by``:
    measurement that would show it.   ``quantities``: the estimates it bears on; none named is every one.
    """

    code: str
    taken_for_granted: str
    unseen: str
    effect: str
    shown_by: str
    quantities: tuple[str, ...] = ()


def assumed(
    say: Callable[..., str],
    code: str,
    quantities: tuple[str, ...] = (),
    *,
    key: str = "",
    taken: str = "taken",
    unseen: str = "unseen",
    effect: str = "effect",
    **fields: object,
) -> Assumption:
    """Return an assumption in the words of a catalogue, under ``key`` or its code.

    ``taken``, ``unseen``, ``effect``: endings of their keys, given where these depend on the campaign.
    ``fields``: what stands in the sentences.
    """
    sentences = [say(f"assumption.{key or code}.{ending}", **fields) for ending in (taken, unseen, effect, "shown")]
    return Assumption(code, sentences[0], sentences[1], sentences[2], sentences[3], quantities)


def assumptions_of(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted, by the section "campaign" of its plan or manifest.

    Empty for a campaign that only records.
    """
    declared = declared_by(campaign)
    return list(named(declared.assumptions)(campaign)) if declared is not None and declared.assumptions else []
