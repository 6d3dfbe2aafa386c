"""Wires and logs of other people beside what their libraries, or numpy, say of them: rows of the validation record.

``make public FROM=FOLDER`` reads them again where the folder holds them as ``owner+name/path``, or the bytes that were
taken out of hex text or levels of a line as ``NAME.bin``. It fails where a figure is another one or a file is missing.
"""

import sys
import tempfile
from collections.abc import Iterator
from io import BytesIO
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bench.commands.import_log import import_log
from bench.frame import decode_capture, parse_frame
from bench.replay import replay_series

KNOWN = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
WIRES, LOGS = (
    "wire | form | lines | minutes | frames | the same as (`.c`: own parser)",
    "log | form | lines | rows | span, s | mean, as numpy",
)
HEAD = "mapping: public\nuut: {model: M, serial: S}\nsite: {gravity: 9.81 m/s2}\n"


def section() -> Iterator[str]:
    """Yield the lines of both tables."""
    yield "\n## Wires and logs of other people\n"
    yield "As written from the docs (`tests/public_captures.yaml`); `make public FROM=FOLDER` reads them again."
    yield "A mapping took 0.3 minutes."
    for heads, entries in ((WIRES, KNOWN["wires"]), (LOGS, KNOWN["logs"])):
        yield f"\n| {heads} |\n|{'---|' * 6}"
        for entry in entries:
            if "frames" in entry:
                more = [entry["minutes"], f"{entry['frames']:,}", entry["same"]]
            else:
                more = [f"{entry['rows']:,}", entry["span_s"], f"{entry['of']} {entry['mean']:.12g}"]
            yield f"| {' | '.join(map(str, [entry['at'], entry['form'], entry['text'].count(chr(10)), *more]))} |"


def found(entry: dict[str, Any], path: Path) -> list[float]:
    """Return frames of a wire, or rows, span and mean of a log."""
    if "frames" in entry:
        counts = decode_capture(parse_frame(entry["text"], "public"), BytesIO(path.read_bytes())).counts
        return [counts.frames + counts.other]
    with tempfile.TemporaryDirectory() as made:
        mapping, out = Path(made) / "m.yaml", Path(made) / "out"
        mapping.write_text(HEAD + entry["text"], encoding="utf-8")
        import_log(mapping, path, out)
        columns = replay_series(next(out.iterdir())).columns
    return [columns["t_s"].size, float(np.ptp(columns["t_s"])), float(np.mean(columns[entry["of"]]))]


if __name__ == "__main__":
    wrong = 0
    for known in (*KNOWN["wires"], *KNOWN["logs"]):
        place = known["at"].partition("@")[0].replace("/", "+") + "/" + known["at"].partition(":")[2]
        file = Path(sys.argv[1]) / known.get("bytes", place)
        due = [known[key] for key in ("frames", "rows", "span_s", "mean") if key in known]
        seen = found(known, file) if file.exists() else []
        wrong += not (seen and all(isclose(*pair, rel_tol=1e-8, abs_tol=1e-12) for pair in zip(seen, due, strict=True)))
        print(seen or "is not there", due, known["at"])
    sys.exit(wrong > 0)
