"""The scripts of the page against documents nobody here wrote, and against Python's own reading of the same bytes."""

import struct
from collections.abc import Iterator
from typing import Any

import pytest
from browser_rig import PageServer, Visitor, visiting
from playwright.sync_api import Browser

pytestmark = pytest.mark.waits

# RFC 7386, appendix A: original, patch, result.
RFC_7386: list[tuple[Any, Any, Any]] = [
    ({"a": "b"}, {"a": "c"}, {"a": "c"}),
    ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
    ({"a": "b"}, {"a": None}, {}),
    ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}),
    ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
    ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}),
    ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
    ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}),
    (["a", "b"], ["c", "d"], ["c", "d"]),
    ({"a": "b"}, ["c"], ["c"]),
    ({"a": "foo"}, None, None),
    ({"a": "foo"}, "bar", "bar"),
    ({"e": None}, {"a": 1}, {"e": None, "a": 1}),
    ([1, 2], {"a": "b", "c": None}, {"a": "b"}),
    ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
]


@pytest.fixture(scope="module")
def visitor(browser: Browser, server: PageServer) -> Iterator[Visitor]:
    with visiting(browser, server, "viewer", timezone_id="Asia/Seoul") as one:
        one.page.goto(f"{server.origin}/")
        yield one


@pytest.mark.parametrize(("original", "patch", "result"), RFC_7386)
def test_merge_patch_is_that_of_the_rfc(visitor: Visitor, original: Any, patch: Any, result: Any) -> None:
    script = "async ([one, other]) => (await import('/static/points.js')).mergePatch(one, other)"
    assert visitor.page.evaluate(script, [original, patch]) == result


def test_batches_and_history_are_read_as_written(visitor: Visitor) -> None:
    times, pairs = [1.5, 2.5, 3.5], [0.5, 1.5, -2.0, 4.0] * 3
    body = struct.pack("<3d12f", *times, *pairs)
    script = """async ([bytes, reader]) => {
      const found = (await import("/static/points.js"))[reader](Uint8Array.from(bytes).buffer);
      return { ...found, t_s: [...found.t_s], pairs: [...found.pairs] };
    }"""
    batch = visitor.page.evaluate(script, [list(struct.pack("<IHH", 4_000_000_000, 3, 1) + body), "readBatch"])
    assert batch == {"first": 4_000_000_000, "n": 3, "flags": 1, "signals": 2, "t_s": times, "pairs": pairs}
    rows = visitor.page.evaluate(script, [list(struct.pack("<IId", 3, 2, 162.0) + body), "readHistory"])
    assert rows == {"n": 3, "signals": 2, "bucket_s": 162.0, "t_s": times, "pairs": pairs}


def test_a_line_has_every_extreme_and_bridges_no_gap(visitor: Visitor) -> None:
    script = """async () => {
      const { lineOf } = await import("/static/points.js");
      const pairs = Float32Array.of(1, 9, NaN, NaN, 2, 8);
      const line = lineOf({ n: 3, signals: 1, t_s: Float64Array.of(1, 2, 3), pairs }, 0);
      return [[...line.t], [...line.y].map((one) => Number.isNaN(one) ? "gap" : one)];
    }"""
    t_ms, values = visitor.page.evaluate(script)
    assert t_ms == [1000, 1000, 2000, 2000, 3000, 3000]
    assert values == [1, 9, "gap", "gap", 2, 8]


def test_a_wide_bucket_is_a_box_that_ends_where_the_next_begins(visitor: Visitor) -> None:
    script = """async () => {
      const { boxesOf } = await import("/static/points.js");
      const rows = { n: 2, signals: 1, bucket_s: 10, t_s: Float64Array.of(0, 4), pairs: Float32Array.of(1, 9, 2, 8) };
      const line = boxesOf(rows, 0);
      return [[...line.t], [...line.y]];
    }"""
    t_ms, values = visitor.page.evaluate(script)
    assert [(min(t_ms[k : k + 6]), max(t_ms[k : k + 6])) for k in (0, 6)] == [(0, 4000), (4000, 14000)]
    assert [(min(values[k : k + 6]), max(values[k : k + 6])) for k in (0, 6)] == [(1, 9), (2, 8)]


def test_the_ring_stays_small_and_marks_what_is_missing(visitor: Visitor) -> None:
    script = """async () => {
      const { Ring } = await import("/static/points.js");
      const ring = new Ring();
      ring.begin(1);
      const batch = (first, n, flags) => ({ first, n, flags, signals: 1,
        t_s: Float64Array.from({ length: n }, (_, k) => first + k), pairs: new Float32Array(2 * n).fill(first) });
      const answers = [];
      for (let first = 0; first < 5000; first += 10) answers.push(ring.add(batch(first, 10, 0)));
      const kept = ring.since(-Infinity);
      const torn = [ring.add(batch(6000, 10, 0)), ring.add(batch(6000, 10, 1))];
      const after = ring.since(4998);
      const values = [...after.pairs].slice(0, 6).map((one) => Number.isNaN(one) ? "gap" : one);
      return [answers.every(Boolean), kept.n, kept.t_s[0], torn, [...after.t_s].slice(0, 3), values];
    }"""
    whole, kept, first, torn, times, values = visitor.page.evaluate(script)
    assert (whole, kept, first) == (True, 600, 4400)
    assert torn == [False, True]
    assert times[0] == 4999
    assert 4999 < times[1] < times[2] == 6000
    assert values[2:4] == ["gap", "gap"]


@pytest.mark.parametrize(
    ("form", "expected"),
    [("utc", "2026-11-20 18:45:50Z"), ("local", "2026-11-21 03:45:50+09:00"), ("elapsed", "+1:01:40")],
)
def test_times_are_written_in_full(visitor: Visitor, form: str, expected: str) -> None:
    script = """async (form) => {
      (await import("/static/base.js")).setTimeForm(form);
      return (await import("/static/words.js")).stamp(1795200350, 1795200350 - 3700);
    }"""
    assert visitor.page.evaluate(script, form) == expected
