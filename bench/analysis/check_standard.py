"""A check standard: a unit of known history on a channel of its own, measured in every campaign beside the unit.

What no data of one campaign can show, a common gain of the calibrator above all, moves the check standard too. So its
results are a calibration of their own, which the history charts, and belong to nothing that is said of the unit.

Source: ISO/IEC 17025:2017, 7.7.1; docs/method-uncertainty.md.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from bench.analysis.analysis import Analysis
from bench.analysis.estimates import Document

OF_UNIT = ":"  # between the name of a session and the serial number of one of its units


def without_check_standard(document: Document, campaign: Document) -> Document:
    """Return results.json of the unit under test alone; ``campaign``: that section of the manifest."""
    channel = check_channel(campaign)
    if channel is None:
        return document
    return {**document, "estimates": [entry for entry in document["estimates"] if not _is_of(entry, channel)]}


def of_check_standard(document: Document, campaign: Document) -> Document | None:
    """Return results.json of the check standard alone, as a session of its own; None if the campaign has none."""
    channel = check_channel(campaign)
    if channel is None:
        return None
    named = campaign["check_standard"]
    of_it = [entry for entry in document["estimates"] if _is_of(entry, channel)]
    return of_serial({**document, "uut": {**document["uut"], "model": named["model"]}}, named["serial"], of_it)


def of_serial(document: Document, serial: str, estimates: list[Any]) -> Document:
    """Return results.json of one of several units of a session."""
    provenance = document["provenance"]
    return {
        **document,
        "session": f"{document['session']}{OF_UNIT}{serial}",
        "uut": {**document["uut"], "serial": serial},
        "provenance": {**provenance, "session_sha256": f"{provenance['session_sha256']}{OF_UNIT}{serial}"},
        "estimates": estimates,
    }


def compensation_of_unit(analysis: Analysis, campaign: Document) -> tuple[Analysis, Document]:
    """Return an analysis without what compensates the check standard, and the campaign without its channel."""
    channel = check_channel(campaign)
    if channel is None:
        return analysis, campaign
    channels = [entry for entry in campaign.get("channels", ()) if entry["number"] != channel]
    compensation = [part for part in analysis.compensation if part["channel"] != channel]
    return replace(analysis, compensation=compensation), {**campaign, "channels": channels}


def check_channel(campaign: Document) -> int | None:
    """Return the channel of the check standard, None for a campaign without one."""
    named = campaign.get("check_standard")
    return None if named is None else int(named["channel"])


def _is_of(entry: Document, channel: int) -> bool:
    return bool(entry["conditions"].get("channel") == channel)
