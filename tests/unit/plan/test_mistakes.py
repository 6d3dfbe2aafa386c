"""Mistakes of users: each is told with its place and a next step in words of the bench, or it changes nothing."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from plan_sample import mistakes

from bench.frame import load_frame
from bench.model.errors import InputErrors
from bench.plan import compile_sequence, summarise

TABLE = yaml.safe_load(Path(__file__).with_name("mistakes.yaml").read_text(encoding="utf-8"))
LIBRARY = re.compile(r"(?i)input should|should (match|have)|extra inputs|field required|constrained|another value")


@pytest.mark.parametrize("row", TABLE["mistakes"].values(), ids=TABLE["mistakes"])
def test_a_mistake_is_told_in_words_of_the_bench_or_changes_nothing(tmp_path: Path, row: dict[str, Any]) -> None:
    for name, text in TABLE["files"].items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    changed, text = tmp_path / row["in"], TABLE["files"][row["in"]]
    old, new = row.get("old", ""), row.get("new", "").replace("MANY", ", ".join(map(str, range(300))))
    assert old in text
    text = row.get("whole", text.replace(old, new, -1 if old == "\n" else 1))
    changed.write_bytes(text.encode(row.get("as", "utf-8")))
    path = tmp_path / "sequences/sup.yaml" if changed.parent.name == "stations" else changed
    try:
        found, said = (mistakes(path), []) if path.parent.name == "sequences" else ([], [load_frame(path).name])
    except InputErrors as error:
        found, said = error.errors, []
    lines = [str(error) for error in found]
    assert [f"{one.code} {Path(one.where).name.rpartition(':')[0]}" for one in found] == row.get("told", []), lines
    assert all(re.search("Next: |did you mean |; (write|use) ", line) for line in lines)
    assert not LIBRARY.search(" ".join(lines))
    assert bool(found) != ("taken" in row)
    if not found and path.parent.name == "sequences":
        said = list(summarise(compile_sequence(path)).slips)
    assert row.get("says", "") in " ".join([*lines, *said])
