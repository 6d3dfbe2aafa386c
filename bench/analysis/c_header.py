"""What the C headers of all coefficients share: the comment at their top, and text that cannot break out of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def preamble(document: Mapping[str, Any]) -> list[str]:
    """What a reader of the header must know: unit, simulated or not, signs, sources."""
    unit = document["uut"]
    lines = [f"Compensation of {unit['model']}, serial number {unit['serial']}."]
    if document["simulated"]:
        lines += ["", "SIMULATED: these numbers come from a simulated bench. They are no calibration of any unit."]
    lines += ["", "Signs:"] + [f"  {name}: {text}" for name, text in document["signs"].items()]
    lines += ["", "Sources:"]
    for source in document["sources"]:
        lines += [f"  {source['session']}: {source['campaign']}, method {source['method']}, {source['software']}"]
        lines += [f"    session SHA-256 {source['session_sha256']}", f"    worst verdict: {source['worst_verdict']}"]
        lines += [f"    MISSING: {one}" for one in source["missing"]]
    return lines


def comment(lines: Sequence[str]) -> str:
    """A C comment. What a session says goes into it, so nothing in a line may end it or leave ASCII."""
    return "\n".join(["/*", *(f" * {safe(line)}".rstrip() for line in lines), " */", ""])


def safe(text: str) -> str:
    """Return a text as one line of ASCII that neither begins nor ends a comment."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").encode("ascii", "replace").decode().splitlines())
