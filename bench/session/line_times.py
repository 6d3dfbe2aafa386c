"""How long the frames of a session take on their lines, from the frame definitions and the baud rates it holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.frame import parse_frame
from bench.model.errors import InputError
from bench.model.yamlio import parse_yaml
from bench.plan import StationFile

BITS_PER_BYTE = 10  # start bit, eight bits, stop bit


def line_times_s(manifest: Mapping[str, Any], texts: Mapping[str, str]) -> dict[str, float]:
    """Return seconds of a frame by link; links that are no serial port or whose frames vary in length are left out."""
    station = next((name for name in texts if name.startswith("stations/")), None)
    if station is None:
        return {}
    try:
        ports = parse_yaml(texts[station], station, StationFile).model.links
    except InputError:  # a station of another version
        return {}
    found = {}
    for link, frame in manifest.get("links", {}).items():
        baud = ports[link].baud if link in ports else None
        if baud is None or frame not in texts:
            continue
        layout = parse_frame(texts[frame], frame).layout
        lengths = {message.length for message in layout.messages}
        if len(lengths) == 1 and 0 not in lengths:
            found[link] = BITS_PER_BYTE * lengths.pop() / baud
    return found
