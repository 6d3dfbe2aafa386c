"""The live view of Jupyter at a feed that was made from docs/live-protocol.md; a real run is watched in tests/runs."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from top_sample import NAMES, FeedStandIn

import bench
from bench.model.clock import WallClock
from bench.model.errors import BenchError
from bench.record.journal import JOURNAL_NAME

SIGNAL = NAMES[2]
HOLDER = """
import sys
from pathlib import Path
from bench.record.journal import _locked
descriptor = _locked(Path(sys.argv[1]))
print(flush=True)
sys.stdin.read()
"""


class Notebook:
    """What Jupyter would show: each figure, and how its picture came to the page."""

    def __init__(self) -> None:
        self.figures: list[Figure] = []
        self.shown: list[tuple[str, bytes]] = []

    def DisplayHandle(self) -> Any:
        return SimpleNamespace(
            display=lambda image: self.shown.append(("display", image)),
            update=lambda image: self.shown.append(("update", image)),
        )

    def Image(self, data: bytes) -> bytes:
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        return data


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> Notebook:
    made = Notebook()
    monkeypatch.setitem(sys.modules, "IPython.display", made)
    plain = Figure.savefig

    def kept(figure: Figure, *words: Any, **options: Any) -> None:
        made.figures.append(figure)
        plain(figure, *words, **options)

    monkeypatch.setattr(Figure, "savefig", kept)
    return made


@pytest.fixture
def feed(tmp_path: Path) -> Iterator[FeedStandIn]:
    made = FeedStandIn(tmp_path)
    made.made = 30
    (tmp_path / "session.open").touch()
    yield made
    made.close()


def seconds(monkeypatch: pytest.MonkeyPatch, *acts: Callable[[], None]) -> None:
    """Let something happen in each second of the view instead of waiting for it."""
    left = iter(acts)
    monkeypatch.setattr(WallClock, "sleep", lambda self, time_s: next(left)())


def test_a_figure_is_drawn_each_second_until_the_session_is_closed(
    notebook: Notebook, feed: FeedStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def later() -> None:
        feed.made = 700

    def ended() -> None:
        feed.close()
        (tmp_path / "session.open").unlink()

    seconds(monkeypatch, later, ended)
    bench.watch(tmp_path, SIGNAL)
    assert [how for how, _ in notebook.shown] == ["display", "update"]
    (axes,) = notebook.figures[-1].axes
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("bench time / s", f"{SIGNAL} / 1", "soak")
    (band,) = axes.collections
    corners = band.get_paths()[0].vertices
    counts = np.arange(100, 700)  # the last minute; point k lies at k / 10 s and spans k + 2 to k + 3 in this column
    for t_s, low in zip(counts / 10, counts + 2, strict=True):
        at = corners[np.isclose(corners[:, 0], t_s)]
        assert (at[:, 1].min(), at[:, 1].max()) == (low, low + 1)


def test_a_busy_run_is_awaited(
    notebook: Notebook, feed: FeedStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its feed is closed, and a living process has its journal open: it writes the end of its recording."""
    (tmp_path / JOURNAL_NAME).touch()
    command = [sys.executable, "-c", HOLDER, str(tmp_path / JOURNAL_NAME)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        writer.stdout.readline()
        seconds(monkeypatch, feed.close, lambda: None, (tmp_path / "session.open").unlink)
        bench.watch(tmp_path, SIGNAL)
        writer.stdin.close()
    assert len(notebook.shown) == 1


def refused(code: str, path: Path, signal: str = SIGNAL) -> str:
    with pytest.raises(BenchError) as caught:
        bench.watch(path, signal)
    assert caught.value.code == code
    return str(caught.value)


def test_what_cannot_be_shown_is_one_clear_error(
    notebook: Notebook, feed: FeedStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert SIGNAL in refused("B-TAB-010", tmp_path, "port_a.npp[33]")
    refused("B-RUN-100", tmp_path / "nothing")
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "matplotlib.figure", None)
        without.setitem(sys.modules, "matplotlib", None)
        assert "inertial-bench[report]" in refused("B-PKG-005", tmp_path)
    seconds(monkeypatch, feed.close)
    refused("B-RUN-100", tmp_path)  # it died: the session is open, and nobody writes it
    monkeypatch.setitem(sys.modules, "IPython.display", None)
    assert "bench top" in refused("B-TAB-011", tmp_path)
