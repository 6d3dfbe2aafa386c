"""``bench decode``: any raw capture through a frame definition."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from bench.commands.console import console
from bench.frame import decode_file, load_frame, write_csv
from bench.model.errors import ExitStatus
from bench.model.shipped import find_shipped

COUNTS = ("good", "bad", "lost", "duplicate", "suspect", "skipped_bytes", "bytes")


def decode(frame: str, file: Path, csv: Path | None, as_json: bool) -> int:
    """Print the counts of good, bad and lost frames; optionally write the fields as CSV."""
    decoded = decode_file(load_frame(find_shipped("frames", frame)), file)
    written = [] if csv is None else write_csv(decoded, csv)
    summary = decoded.summary()
    if as_json:
        sys.stdout.write(json.dumps(summary, indent=1) + "\n")
        return ExitStatus.PASS
    out = console()
    out.print(f"{file}: {summary['frame']}")
    for name in COUNTS:
        out.print(f"  {name.replace('_', ' '):<14} {summary[name]}")
    for path in written:
        out.print(f"  written        {path}")
    return ExitStatus.PASS
