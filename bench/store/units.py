"""A session of several units: what it says of each of them, as if each had a session of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

OF_UNIT = ":"  # between the name of a session and the serial number of one of its units


def documents_of_units(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """One document per unit if every estimate names the unit it is of (condition ``unit``), else the document itself.

    The serial number is the unit's, the condition is gone: the same unit in another session has the same parameters.
    """
    estimates = document["estimates"]
    serials = dict.fromkeys(one["conditions"].get("unit") for one in estimates)
    if not serials or not all(isinstance(serial, str) for serial in serials):
        return [document]
    return [_of(document, str(serial)) for serial in serials]


def _of(document: Mapping[str, Any], serial: str) -> Mapping[str, Any]:
    estimates = [
        {**one, "conditions": {name: value for name, value in one["conditions"].items() if name != "unit"}}
        for one in document["estimates"]
        if one["conditions"]["unit"] == serial
    ]
    provenance = document["provenance"]
    return {
        **document,
        "session": f"{document['session']}{OF_UNIT}{serial}",
        "uut": {**document["uut"], "serial": serial},
        "provenance": {**provenance, "session_sha256": f"{provenance['session_sha256']}{OF_UNIT}{serial}"},
        "estimates": estimates,
    }
