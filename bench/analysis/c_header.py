"""What the C headers of all coefficients share: the comment at their top, and text that cannot break out of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def c_preamble(document: Mapping[str, Any]) -> str:
    """Return the comment that opens a C header: unit, simulated or not, signs, sources."""
    unit = document["uut"]
    lines = [f"Compensation of {unit['model']}, serial number {unit['serial']}."]
    if document["simulated"]:
        lines += ["", "SIMULATED: these numbers come from a simulated bench. They are no calibration of any unit."]
    lines += ["", "Signs:"] + [f"  {name}: {text}" for name, text in document["signs"].items()]
    lines += ["", "Sources:"]
    for source in document["sources"]:
        lines += [f"  {source['session']}: {source['campaign']}, method {source['method']}, {source['software']}"]
        lines += [f"    session SHA-256 {source['session_sha256']}", f"    worst verdict: {source['worst_verdict']}"]
        lines += [f"    MISSING: {sentence}" for sentence in source["missing"]]
    return "\n".join(["/*", *(f" * {c_text(line)}".rstrip() for line in lines), " */", ""])


def c_text(text: str) -> str:
    """Return what a session says so that nothing in it ends a C comment or leaves ASCII."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").encode("ascii", "replace").decode().splitlines())
