"""Row 1 behind the last step: killed before the session was closed, or before its results were written."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from rehearsal import rehearsed
from soak_campaign import soak_plan

from bench.commands.resume import resume
from bench.commands.session import replay
from bench.model.errors import ExitStatus, InputError
from bench.record import SessionReader, SessionWriter
from bench.session.service import read_view
from bench.session.view import analyse_view


@dataclass
class Ended:
    """A run that has ended, and its folder as it was just before the session was closed."""

    whole: Path
    unclosed: Path


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    folder = tmp_path_factory.mktemp("ended")
    plain = SessionWriter.close

    def close(self: SessionWriter, reason: str) -> str:
        self.flush()
        shutil.copytree(self.folder, folder / "unclosed" / self.folder.name)
        return plain(self, reason)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SessionWriter, "close", close)
        run = rehearsed(folder / "out", soak_plan(folder), seed=2).run
    assert run.outcome.error is None
    return Ended(run.folder, folder / "unclosed" / run.folder.name)


def copied(source: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(source, tmp_path / source.name))


def switched_on(folder: Path) -> int:
    """How often the supply of the unit was switched on in a session."""
    messages = SessionReader(folder).messages(frozenset({"/instrument/supply"}))
    return sum(one.document()["text"].upper().startswith("OUTP ON") for one in messages)


def test_a_session_that_was_not_closed_is_closed_and_nothing_is_switched_on(ended: Ended, tmp_path: Path) -> None:
    folder = copied(ended.unclosed, tmp_path)
    assert (folder / "session.open").exists()
    assert read_view(folder).incomplete
    assert switched_on(folder) > 0
    assert resume(folder, None, None, as_json=True) == ExitStatus.PASS
    view = read_view(folder, strict=True)
    assert not view.incomplete
    assert len(view.splices) == 1
    assert not (folder / "session.open").exists()
    assert switched_on(folder) == switched_on(ended.unclosed)
    before, after = (analyse_view(one)[0]["estimates"] for one in (read_view(ended.whole), view))
    assert [one["value"] for one in after] == [one["value"] for one in before]
    assert replay(folder, as_json=True) == ExitStatus.PASS


def test_results_that_were_not_written_any_more_are_written(ended: Ended, tmp_path: Path) -> None:
    folder = copied(ended.whole, tmp_path)
    segments = {path.name: path.read_bytes() for path in folder.glob("*.mcap")}
    assert resume(folder, None, None, as_json=True) == ExitStatus.PASS
    assert replay(folder, as_json=True) == ExitStatus.PASS
    (folder / "report.html").unlink()  # killed between the two
    assert resume(folder, None, None, as_json=True) == ExitStatus.PASS
    assert {path.name: path.read_bytes() for path in folder.glob("*.mcap")} == segments
    with pytest.raises(InputError, match="B-RES-001"):
        resume(folder, None, None, as_json=True)
