"""A document whose form this software does not know is refused or told with what to do, and never read as less."""

import json
from pathlib import Path

import pytest

from bench.model.errors import InputError
from bench.record import SessionReader, SessionWriter
from bench.run.guard.last_words import guard_lines
from bench.session.acceptances import known_acceptances

OTHER = "of form 2, and this software knows form 1"
NEXT = "go on with the version of the bench that wrote it; nothing was changed"


def test_a_manifest_and_acceptances(tmp_path: Path) -> None:
    for schema in (1, 2):
        SessionWriter.create(tmp_path / str(schema), {"schema": schema}, {}, t_mono_ns=0).close("done")
        (tmp_path / str(schema) / "acceptances.json").write_text(json.dumps({"schema": schema, "more": []}))
    assert SessionReader(tmp_path / "1").manifest == {"schema": 1}
    with pytest.raises(InputError, match=f"B-REC-007: .*0001.mcap: the manifest is {OTHER}. Next: {NEXT}"):
        _ = SessionReader(tmp_path / "2").manifest
    with pytest.raises(InputError, match=f"B-ACC-004: .*acceptances.json: is {OTHER}. Next: {NEXT}"):
        known_acceptances(tmp_path / "2", "")
    with pytest.raises(InputError, match="Next: remove the file"):
        known_acceptances(tmp_path / "1", "")


@pytest.mark.parametrize("before", [[], [{"what": "act", "text": "too hot"}]])
def test_a_log_of_the_guard_confirms_nothing(tmp_path: Path, before: list[dict[str, object]]) -> None:
    entries = [*before, {"v": 2, "what": "safe", "utc": "2026-03-01T01:00:02+00:00"}]
    (tmp_path / "guard.jsonl").write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    (line,) = guard_lines(tmp_path)
    assert line.startswith(f"The guard of {tmp_path} has acted (its log is {OTHER}: {NEXT}), last heard of at 2026-03-")
    assert line.endswith(
        "NOT confirmed: any instrument; it is at it. Next: look again in a minute, until then hands off."
    )
