"""The example and the words of docs/importing.md are what the program does."""

from __future__ import annotations

import re
from pathlib import Path

from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import FileForm, TimeColumn, ValueColumn, mapping_model
from bench.replay.delimited import LogParser

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "importing.md").read_text(encoding="utf-8")


def test_the_ten_line_mapping_reads_the_file_above_it() -> None:
    found = re.search(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    assert len(found[1].splitlines()) == 10
    parser = LogParser(parse_yaml(found[1], "importing.md", mapping_model()).model, "example")
    lines = [line.strip() for line in PAGE.splitlines() if re.match(r"    (time,|2024-)", line)]
    rows = [parser.row(line.encode()) for line in lines]
    assert [row.values for row in rows if row is not None] == [(20.0, 20.31, 1.0000123), (20.0, 20.3, 1.0000125)]


def test_every_key_is_explained() -> None:
    keys = {name for model in (mapping_model(), FileForm, TimeColumn, ValueColumn) for name in model.model_fields}
    assert {key for key in keys if f"`{key}" not in PAGE} == set()
