"""Wires and logs of other people beside what their libraries, or numpy, say of them: rows of the validation record.

``make public FROM=FOLDER`` reads them again where the folder holds them as ``owner+name/path``, or the bytes that were
taken out of hex text or levels of a line as ``NAME.bin``, and fails where a figure is another one.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from io import BytesIO
from math import isclose
from pathlib import Path

import numpy as np
import yaml

from bench.commands.import_log import import_log
from bench.frame import decode_capture, parse_frame
from bench.replay import replay_series

KNOWN = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
HEAD = "mapping: public\nuut: {model: M, serial: S}\nsite: {gravity: 9.81 m/s2}\n"


def section() -> Iterator[str]:
    """Yield the lines of both tables."""
    yield "\n## Wires and logs of other people\n"
    yield "As written from the docs (`tests/public_captures.yaml`); `make public FROM=FOLDER` reads them again."
    yield "A mapping took 0.3 minutes.\n"
    yield "| wire | form | lines | minutes | frames | the same as |\n|---|---|---|---|---|---|"
    for wire in KNOWN["wires"]:
        lines, against = wire["definition"].count("\n"), f"{wire['against']}, {wire['equal']}"
        cells = wire["at"], wire["form"], lines, wire["minutes"], f"{wire['theirs']:,}", against
        yield f"| {' | '.join(map(str, cells))} |"
    yield "\n| log | form | lines | rows | span, s | mean, as numpy |\n|---|---|---|---|---|---|"
    for log in KNOWN["logs"]:
        lines, mean = log["mapping"].count("\n") + 2, f"{log['of']} {log['mean']:.9g}"
        cells = log["at"], log["form"], lines, f"{log['rows']:,}", log["span_s"], mean
        yield f"| {' | '.join(map(str, cells))} |"


def found(entry: dict[str, object], folder: Path) -> list[float] | None:
    """Return frames of a wire, or rows, span and mean of a log; None where the folder lacks it."""
    repository, place = str(entry["at"]).split(":", 1)
    path = folder / str(entry.get("bytes", f"{repository.partition('@')[0].replace('/', '+')}/{place}"))
    if not path.exists():
        return None
    if "definition" in entry:
        counts = decode_capture(parse_frame(str(entry["definition"]), "public"), BytesIO(path.read_bytes())).counts
        return [counts.frames + counts.other]
    with tempfile.TemporaryDirectory() as made:
        mapping, out = Path(made) / "m.yaml", Path(made) / "out"
        mapping.write_text(HEAD + str(entry["mapping"]), encoding="utf-8")
        import_log(mapping, path, out)
        columns = replay_series(next(out.iterdir())).columns
    return [columns["t_s"].size, float(np.ptp(columns["t_s"])), float(np.mean(columns[str(entry["of"])]))]


if __name__ == "__main__":
    wrong = 0
    for entry in (*KNOWN["wires"], *KNOWN["logs"]):
        due = [float(entry[key]) for key in ("theirs", "rows", "span_s", "mean") if key in entry]
        got = found(entry, Path(sys.argv[1]))
        is_right = got is None or all(isclose(a, b, rel_tol=1e-8, abs_tol=1e-12) for a, b in zip(got, due, strict=True))
        wrong += not is_right
        print("is not there" if got is None else "right" if is_right else f"WRONG, {got} for {due}", entry["at"])
    sys.exit(wrong > 0)
