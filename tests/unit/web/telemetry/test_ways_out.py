"""What docs/ways-out.md and its dashboard ask of ``/metrics`` is exported, and the page names all that is."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import yaml

from bench.web.telemetry import SeenRun, families

ROOT = Path(__file__).resolve().parents[4]
PAGE = (ROOT / "docs" / "ways-out.md").read_text(encoding="utf-8")
BOARD = json.loads((ROOT / "docs" / "grafana" / "bench.json").read_text(encoding="utf-8"))
NAME = re.compile(r"\bbench_[a-z_]+\b")


def everything() -> list[SeenRun]:
    """Return runs that together have a sample of every metric."""
    row = {"quantity": "bias", "unit": "A", "value": 1.0, "expanded_uncertainty": 0.1, "limit": 2.0, "conditions": {}}
    link = {"state": "streaming", "frames": 1, "bad": 0, "lost": 0, "duplicate": 0, "rate_Hz": 100.0, "age_s": 0.0}
    counts = dict.fromkeys(("planned", "done", "retaken", "flagged"), 1)
    state = {
        "run": "r", "state": "running", "attention": "none", "uut": {"model": "NGU", "serial": "7"}, "t_utc_s": 1.0,
        "bench": {"state": "off", "confirmed_utc_s": 0.0, "unconfirmed": {}}, "progress": 0.5,
        "eta": {"likely_utc_s": 2.0}, "alarms": [],
        "records": counts, "links": {"a": link}, "estimates": {"rows": [row]}, "session": {"outcome": {"word": "pass"}},
    }  # fmt: skip
    return [SeenRun(state, {"bench.air": 20.0}, 0.0)]


def exported() -> dict[str, set[str]]:
    """Return the labels of every sample, by its name."""
    found: dict[str, set[str]] = {}
    for family in families(everything()):
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def expressions(part: Any) -> list[str]:
    """Return every expression below a part of a document, the queries of variables too."""
    if isinstance(part, list):
        return [text for entry in part for text in expressions(entry)]
    if not isinstance(part, dict):
        return []
    own = [part[key] for key in ("expr", "definition") if isinstance(part.get(key), str)]
    return own + [text for entry in part.values() for text in expressions(entry)]


def blocks() -> list[dict[str, Any]]:
    return [yaml.safe_load(text) for text in re.findall(r"```prometheus\n(.*?)```", PAGE, re.DOTALL)]


def test_every_expression_names_what_is_exported_with_labels_that_it_has() -> None:
    labels, read = exported(), set()
    texts = expressions(BOARD) + expressions(blocks())
    assert len(texts) > 15
    for text in texts:
        for name, matchers in re.findall(r"\b(bench_[a-z_]+)\b(?:\{([^}]*)\})?(?!\")", re.sub(r'"[^"]*"', '""', text)):
            if name in labels:
                read.add(name)
                assert {word.strip() for word in re.findall(r"([a-z_]+)\s*[=!]", matchers)} <= labels[name], text
        assert set(NAME.findall(text)) <= set(labels), text
    left = {
        "bench_outputs_age_seconds",
        "bench_records",
        "bench_run_outcome",
        "bench_link_state",
        "bench_frame_age_seconds",
    }
    assert read == set(labels) - left


def test_the_table_of_the_page_has_every_metric_and_no_other() -> None:
    table = re.findall(r"^\| (`bench_[^|]+) \|", PAGE, re.MULTILINE)
    assert {name for cell in table for name in NAME.findall(cell)} == set(exported())
