"""The live view for Jupyter of docs/live-protocol.md, at a feed that was made from the same page."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from doc_blocks import ROOT, blocks_of
from feed_stand_in import NAMES, T0, FeedStandIn


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the names that the Python of the page defines; ``shown`` collects what Jupyter would show."""
    shown: list[Any] = []
    stand_in = SimpleNamespace(display=shown.append, clear_output=lambda wait: None)
    monkeypatch.setitem(sys.modules, "IPython.display", stand_in)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, Any] = {"shown": shown}
    for block in blocks_of(ROOT / "docs" / "live-protocol.md"):
        if block.language == "python":
            exec(compile(block.text, block.place, "exec"), names)
    return names


def test_the_points_are_those_of_the_run(page: dict[str, Any], tmp_path: Path) -> None:
    feed = FeedStandIn(tmp_path)
    feed.made = 30
    header, t_utc_s, values = page["look"](tmp_path)
    assert header["state"]["state"] == "running"
    assert np.array_equal(t_utc_s, T0 + np.arange(30) / 10)
    assert values.shape == (30, len(NAMES), 2)
    assert values[7, 2].tolist() == [9.0, 10.0]  # point 7, column 2
    assert page["look"](tmp_path, since=28)[1].size == 2
    feed.close()


def test_a_figure_is_drawn_each_second_until_the_session_is_closed(
    page: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    feed, session_open = FeedStandIn(tmp_path), tmp_path / "session.open"
    feed.made = 30
    session_open.touch()
    waits = iter([lambda: None, session_open.unlink])
    monkeypatch.setattr(time, "sleep", lambda seconds: next(waits)())
    page["watch"](tmp_path, NAMES[2])
    feed.close()
    assert len(page["shown"]) == 2
    (axes,) = page["shown"][0].axes
    assert (axes.get_ylabel(), axes.get_title()) == (NAMES[2], "soak")
