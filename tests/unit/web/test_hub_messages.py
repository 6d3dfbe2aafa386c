"""Merge patches, batches and queues: what is sent to a page, without a run and without a page."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from feed_stand_in import T0, first_state
from hypothesis import given
from hypothesis import strategies as st

from bench.web.points import KEPT, LastPoints, Points, binned, no_points
from bench.web.room import Room, merge_patch
from bench.web.viewer import LONGEST_QUEUE, Viewer


def applied(target: Any, patch: Any) -> Any:
    """MergePatch of RFC 7386, section 2, word for word."""
    if isinstance(patch, Mapping):
        target = dict(target) if isinstance(target, Mapping) else {}
        for name, value in patch.items():
            if value is None:
                target.pop(name, None)
            else:
                target[name] = applied(target.get(name), value)
        return target
    return patch


# Appendix A of RFC 7386: original, patch, result
RFC_7386 = [
    ({"a": "b"}, {"a": "c"}, {"a": "c"}),
    ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
    ({"a": "b"}, {"a": None}, {}),
    ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}),
    ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
    ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}),
    ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
    ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}),
    ({"e": None}, {"a": 1}, {"e": None, "a": 1}),
    ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
]


@pytest.mark.parametrize(("original", "patch", "result"), RFC_7386)
def test_a_patch_leads_to_the_results_of_the_rfc(
    original: dict[str, Any], patch: dict[str, Any], result: dict[str, Any]
) -> None:
    assert applied(original, patch) == result
    assert known(applied(original, merge_patch(original, result))) == known(result)


def known(document: Any) -> Any:
    """The document without its nulls, which are the same as nothing."""
    if isinstance(document, Mapping):
        return {key: known(value) for key, value in document.items() if value is not None}
    return document


LEAVES = st.none() | st.integers(-9, 9) | st.text(max_size=2) | st.lists(st.integers(0, 3), max_size=2)
DOCUMENTS = st.recursive(
    st.dictionaries(st.sampled_from("abc"), LEAVES, max_size=3),
    lambda inner: st.dictionaries(st.sampled_from("abc"), LEAVES | inner, max_size=3),
    max_leaves=8,
)


@given(DOCUMENTS, DOCUMENTS)
def test_a_patch_leads_from_any_document_to_any_other(old: dict[str, Any], new: dict[str, Any]) -> None:
    patch = merge_patch(old, new)
    assert known(applied(old, json.loads(json.dumps(patch)))) == known(new)
    assert (patch == {}) == (known(old) == known(new))


def test_a_batch_is_laid_out_as_documented() -> None:
    pairs = np.array([[[1, 2], [3, 4]], [[5, 6], [np.nan, np.nan]]], dtype=np.float32)
    batch = Points(2**32 + 7, np.array([T0, T0 + 0.1]), pairs).batch(1)
    assert struct.unpack_from("<IHH", batch) == (7, 2, 1)  # the number wraps as u32
    assert struct.unpack_from("<2d", batch, 8) == (T0, T0 + 0.1)
    assert struct.unpack_from("<7f", batch, 24)[:6] == (1, 2, 3, 4, 5, 6)
    assert len(batch) == 8 + 2 * 8 + 2 * 2 * 2 * 4


def points(first: int, count: int) -> Points:
    return Points(first, T0 + np.arange(first, first + count) / 10, np.zeros((count, 1, 2), dtype=np.float32) + first)


def test_the_last_minute_is_kept_and_no_more() -> None:
    kept = LastPoints(1)
    for first in range(0, 5000, 3):
        kept.add(points(first, 3))
    shown = kept.all()
    assert (len(shown), shown.stop) == (KEPT, 5001)
    assert np.all(np.diff(shown.t_utc_s) > 0.09)
    kept.add(points(7000, 4))  # points are missing before it
    assert (kept.all().first, len(kept.all())) == (7000, 4)
    assert len(LastPoints(3).all()) == 0
    assert LastPoints(3).all().pairs.shape == (0, 3, 2)


def test_points_of_a_width_hold_the_least_and_greatest_value_of_each_step() -> None:
    seed = 3
    values = np.random.default_rng(seed).normal(size=1000).astype(np.float32)[:, None]
    stamps = T0 + np.arange(1000) / 100 + 0.004
    found = binned(stamps, values, values, 0.1)
    assert np.allclose(found.t_utc_s, T0 + np.arange(1, 101) / 10, atol=1e-6)
    assert np.array_equal(found.pairs[:, 0, 0], values.reshape(100, 10).min(axis=1))
    assert np.array_equal(found.pairs[:, 0, 1], values.reshape(100, 10).max(axis=1))
    values[50:60] = np.nan
    assert np.isnan(binned(stamps, values, values, 0.1).pairs[5]).all()
    assert len(binned(np.zeros(0), values[:0], values[:0], 0.1)) == len(no_points(1)) == 0


def test_a_viewer_that_does_not_read_loses_what_waits_and_gets_a_snapshot() -> None:
    viewer = Viewer("viewer")
    assert viewer.stale
    viewer.put("dropped: the snapshot will hold it")
    assert viewer.take() is None
    viewer.start(["snapshot"])
    assert (viewer.take(), viewer.take()) == ("snapshot", None)
    for number in range(LONGEST_QUEUE):
        viewer.put(str(number))
    assert not viewer.stale
    viewer.put("one too many")
    assert viewer.stale
    assert viewer.take() is None, "all that waited is gone"


def test_everybody_in_a_room_is_told_the_same_and_only_what_changed() -> None:
    room = Room(first_state())
    watcher, boss = Viewer("viewer"), Viewer("operator")
    room.viewers |= {watcher, boss}
    for viewer in (watcher, boss):
        viewer.start(room.snapshot(viewer))
    heads = [json.loads(str(viewer.take())) for viewer in (watcher, boss)]
    assert [head["state"]["role"] for head in heads] == ["viewer", "operator"]
    assert {head["seq"] for head in heads} == {0}
    assert [viewer.take() for viewer in (watcher, boss)] == [no_points(0).batch()] * 2
    room.change(progress=0.2, wait={"reason": "soak"}, step=None)
    room.change(progress=0.2)
    delta = {"type": "delta", "seq": 1, "patch": {"step": None, "progress": 0.2, "wait": {"reason": "soak"}}}
    assert json.loads(str(watcher.take())) == delta
    assert json.loads(str(boss.take())) == delta
    assert watcher.take() is None, "what did not change is not sent"
    assert json.loads(str(room.snapshot(watcher)[0]))["seq"] == 1
