"""Records and moments of their pulses against plain Python sums: any damage, any chunking, windows over any edge."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from record_sample import FRAME_NS, MASTER, NS, Stream, chunks_of, constant_stream, frame, housekeeping, stream

from bench.frame import LinkDecoder, parse_frame
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordCutter, RecordRow
from bench.record.window import pulse_timing

NAMES = ("npp", "ppp", "af_clock", "master_count", "fg_count")


def window(number: int, first: int, frames: int, **conditions: object) -> RecordWindow:
    return RecordWindow(
        number, "port_a", first, frames, first * FRAME_NS, (first + frames + 1) * FRAME_NS, dict(conditions)
    )


def cut(
    pieces: list[tuple[int, bytes]],
    windows: list[RecordWindow],
    flush_each: int = 1,
    until_ns: int | None = None,
    *,
    timed: bool = False,
) -> list[RecordRow]:
    """Rows of all windows, flushing the decoder after every ``flush_each`` pieces (receive time, bytes)."""
    decoder = LinkDecoder(frame("ngu_a"))
    cutter = RecordCutter(frame("ngu_a"))
    for item in windows:
        cutter.open(item, until_ns=until_ns, timed=timed)
    rows = []
    for index, (t_ns, chunk) in enumerate(pieces):
        decoder.push(t_ns, chunk)
        if index % flush_each == flush_each - 1:
            cutter.feed(decoder.flush())
            rows += cutter.finished()
    cutter.feed(decoder.flush())
    return sorted(rows + cutter.finished() + cutter.close_all(), key=lambda row: row.window.number)


def by_second(made: Stream, keep: np.ndarray | None = None) -> list[tuple[int, bytes]]:
    """One piece per second of stream time; frames outside ``keep`` are lost on the way."""
    pieces = []
    for start in range(0, len(made.counter), 100):
        rows = [k for k in range(start, min(start + 100, len(made.counter))) if keep is None or keep[k]]
        if rows:
            pieces.append((int(made.counter[rows[-1]] + 1) * FRAME_NS, made.frames[rows].tobytes()))
    return pieces


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), flush_each=st.integers(1, 40))
def test_lost_frames_and_any_batching(seed: int, flush_each: int) -> None:
    rng = np.random.default_rng(seed)
    count = 900
    made = stream(count, seed=seed % 1000)
    keep = rng.random(count) > rng.choice([0.0, 0.01, 0.3])
    keep[0] = True
    spans = [(int(rng.integers(1, 300)), int(rng.integers(1, 300))) for _ in range(3)]
    windows = [window(k, first, frames) for k, (first, frames) in enumerate(spans)]
    rows = cut(by_second(made, keep), windows, flush_each)
    for row, (first, frames) in zip(rows, spans, strict=True):
        inside = [k for k in range(first, first + frames) if keep[k]]
        early = [k for k in inside if k < first + frames // 2]
        for sums, chosen in ((row.sums, inside), (row.first_half, early)):
            for name in NAMES:
                expected = made.expected(name, chosen) if chosen else [0] * sums[name].size
                assert np.atleast_1d(sums[name]).tolist() == expected
        assert (row.frames, row.lost, row.bad) == (len(inside), frames - len(inside), 0)
        assert bool(row.quality & Quality.LOST) == (row.lost > 0)


@settings(max_examples=30, deadline=None)
@example(seed=86)  # one lost frame with the pattern in it twice: more candidates than frames
@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_bytes_give_the_same_rows_however_they_arrive(seed: int) -> None:
    """Flips, drops and insertions; chunks of 1-700 bytes; the batches must not matter."""
    rng = np.random.default_rng(seed)
    made = stream(600, seed=seed % 1000)
    raw = bytearray(made.frames.tobytes())
    for at in rng.integers(0, len(raw), 15).tolist():
        kind = rng.integers(0, 3)
        if kind == 0:
            raw[at % len(raw)] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            del raw[at % len(raw)]
        else:
            raw.insert(at % len(raw), int(rng.integers(0, 256)))
    pieces, sent = [], 0
    for chunk in chunks_of(bytes(raw), rng):
        sent += len(chunk)
        pieces.append((sent * FRAME_NS // 57, chunk))
    windows = [window(k, 10 + 170 * k, 160) for k in range(3)]
    reference = cut(pieces, windows, 1)
    for flush_each in (3, 17, len(pieces)):
        assert [comparable(row) for row in cut(pieces, windows, flush_each)] == [comparable(row) for row in reference]
    assert all(row.frames + row.lost == 160 for row in reference)
    candidates = bytes(raw).count(made.frames[0, :2].tobytes())  # the pattern may stand inside a lost frame once more
    assert sum(row.bad + row.frames for row in reference) <= candidates


def comparable(row: RecordRow) -> tuple[object, ...]:
    sums = {name: value.tolist() for name, value in row.sums.items()}
    return sums, row.frames, row.lost, row.bad, row.quality, row.duplicate, row.suspect, dict(row.context)


def test_bad_frames_are_counted_where_they_are() -> None:
    made = stream(500)
    for k in (99, 100, 250, 251, 299, 300):
        made.frames[k, 20] ^= 0x40
    rows = cut(by_second(made), [window(1, 100, 200)])
    assert (rows[0].bad, rows[0].lost, rows[0].frames) == (4, 4, 196)
    assert rows[0].quality == Quality.LOST | Quality.BAD_FRAMES
    kept = [k for k in range(100, 300) if k not in (100, 250, 251, 299)]
    assert rows[0].sums["npp"].tolist() == made.expected("npp", kept)


def test_repeated_frames_count_once() -> None:
    made = stream(400)
    frames = [*range(150), *range(140, 150), *range(150, 400)]
    pieces = [(k * FRAME_NS + FRAME_NS, made.frames[k].tobytes()) for k in frames]
    for flush_each in (1, 7, 1000):
        row = cut(pieces, [window(1, 100, 200)], flush_each)[0]
        assert row.sums["npp"].tolist() == made.expected("npp", slice(100, 300))
        assert (row.frames, row.lost, row.duplicate, row.quality) == (200, 0, 10, Quality.DUPLICATE)


def test_impossible_counts_are_left_out_and_flagged() -> None:
    made = stream(400)
    made.columns["master_count"][150] = MASTER * 2
    made.columns["npp"][170, 3] = 60_000  # more pulses than clock edges
    made.frames = frame("ngu_a").encode(made.columns, 400)
    row = cut(by_second(made), [window(1, 100, 200)])[0]
    kept = [k for k in range(100, 300) if k not in (150, 170)]
    assert row.sums["npp"].tolist() == made.expected("npp", kept)
    assert int(row.sums["master_count"]) == MASTER * 198
    assert (row.suspect, row.lost) == (2, 2)
    assert row.quality == Quality.SUSPECT | Quality.LOST


@pytest.mark.parametrize(("channel", "flagged"), [(3, True), (4, False), (None, True)])
def test_over_range_of_the_records_own_channel(channel: int | None, flagged: bool) -> None:
    made = stream(300)
    made.columns["status"][150] = 1 << 3  # bit 3 = channel 3
    made.frames = frame("ngu_a").encode(made.columns, 300)
    conditions = {} if channel is None else {"channel": channel}
    rows = cut(by_second(made), [window(1, 100, 100, **conditions), window(2, 200, 50, **conditions)])
    assert rows[0].quality == (Quality.OVER_RANGE if flagged else Quality.GOOD)
    assert rows[1].quality == Quality.GOOD


def test_frames_after_the_time_limit_do_not_count() -> None:
    made = stream(300)
    pieces = [((k + 1) * FRAME_NS, made.frames[k].tobytes()) for k in range(300)]
    for flush_each in (1, 300):
        row = cut(pieces, [window(1, 100, 100)], flush_each, until_ns=150 * FRAME_NS)[0]
        assert (row.frames, row.lost) == (50, 50)
        assert row.sums["npp"].tolist() == made.expected("npp", slice(100, 150))


def test_context_is_the_mean_between_first_and_last_frame() -> None:
    made = stream(400)
    house, cutter, decoder = LinkDecoder(frame("ngu_b")), RecordCutter(frame("ngu_a")), LinkDecoder(frame("ngu_a"))
    cutter.open(window(1, 110, 200))
    for second in range(4):
        t_ns = (second + 1) * NS
        house.push(t_ns, housekeeping(10, 10 * second, temperature_degC=20.0 + second))
        decoder.push(t_ns, made.frames[100 * second : 100 * second + 100].tobytes())
        cutter.feed_context(house.flush())
        cutter.feed(decoder.flush())
    row = cutter.close(1)
    # frames 110-309 arrive at 2, 3 and 4 s, the window ends at 3.11 s: housekeeping of 2 and 3 s counts
    assert row.context["unit_temperature_degC"] == pytest.approx(21.5 + 0.045 + 0.015)
    assert row.context["unit_temperature_4_degC"] == pytest.approx(21.5 + 0.045 + 0.03)
    assert row.context["supply_voltage_V"] == pytest.approx(28.0)
    assert row.context["rails_2_V"] == pytest.approx(15.0)


def cut_with_housekeeping(degC: float | None, flush_each: int, **conditions: object) -> RecordRow:
    """One record of seconds 2 and 3, with a unit temperature of ``degC`` all the time, or only after it (None)."""
    made = stream(600)
    house, cutter, decoder = LinkDecoder(frame("ngu_b")), RecordCutter(frame("ngu_a")), LinkDecoder(frame("ngu_a"))
    cutter.open(window(1, 110, 200, **conditions))
    for second in range(6):
        t_ns = (second + 1) * NS
        if degC is not None or second > 4:
            house.push(t_ns, housekeeping(10, 10 * second, temperature_degC=degC or 20.0))
        decoder.push(t_ns, made.frames[100 * second : 100 * second + 100].tobytes())
        if second % flush_each == flush_each - 1:
            cutter.feed_context(house.flush())
            cutter.feed(decoder.flush())
    return cutter.close(1)


@pytest.mark.parametrize("flush_each", [1, 3, 6])
@pytest.mark.parametrize(
    ("degC", "conditions", "quality"),
    [
        (50.2, {"temperature_degC": 50.0, "settle_band_degC": 1.0}, Quality.GOOD),
        (48.8, {"temperature_degC": 50.0, "settle_band_degC": 1.0}, Quality.NOT_SETTLED),
        (51.1, {"temperature_degC": 50.0, "settle_band_degC": 1.0}, Quality.NOT_SETTLED),
        (23.0, {"temperature_degC": 50.0}, Quality.GOOD),  # an older session states no band
        (23.0, {"temperature_degC": 50.0, "settle_band_degC": None}, Quality.GOOD),
        (50.2, {"temperature_degC": 50.0, "settle_band_degC": 1.0, "settled": False}, Quality.NOT_SETTLED),
        (None, {"temperature_degC": 50.0, "settle_band_degC": 1.0}, Quality.STALE),
        (None, {"temperature_degC": 20.0}, Quality.STALE),
        (None, {"temperature_degC": 50.0, "settled": False}, Quality.STALE | Quality.NOT_SETTLED),
    ],
)
def test_a_unit_off_its_temperature_is_not_settled(
    degC: float | None, conditions: dict[str, object], quality: Quality, flush_each: int
) -> None:
    """The chamber may fail long after the soak; each record is judged by its own mean, however it was decoded."""
    row = cut_with_housekeeping(degC, flush_each, **conditions)
    assert (row.quality, bool(row.context)) == (quality, degC is not None)


def test_a_record_without_frames_is_closed_once_and_frames_without_counts_cannot_be_cut() -> None:
    row = cut(by_second(stream(50)), [window(1, 100, 20)])[0]
    assert (row.frames, row.lost, row.quality, row.context) == (0, 20, Quality.LOST, {})
    assert row.sums["npp"].tolist() == [0] * 10
    cutter = RecordCutter(frame("ngu_a"))
    cutter.open(window(7, 0, 5))
    assert cutter.close(7).frames == 0
    with pytest.raises(KeyError):
        cutter.close(7)
    with pytest.raises(InputError, match="B-REC-020"):
        RecordCutter(frame("vn100_binary"))
    text = frame("ngu_a").text.replace(", role: counter", "")
    with pytest.raises(InputError, match="B-REC-020"):
        RecordCutter(parse_frame(text, "no counter"))


KEYS = ("moment1", "moment2", "first", "last", "at_first", "at_last")


def by_hand(counts: list[list[int]], first_counter: int) -> dict[str, list[int]]:
    """The definition, frame by frame and channel by channel; frames count from 1."""
    found: dict[str, list[int]] = {key: [] for key in KEYS}
    for channel in range(len(counts[0])):
        x = [row[channel] for row in counts]
        pulsed = [j for j, count in enumerate(x) if count]
        found["moment1"].append(sum((j + 1) * count for j, count in enumerate(x)))
        found["moment2"].append(sum((j + 1) ** 2 * count for j, count in enumerate(x)))
        found["first"].append(first_counter + pulsed[0] if pulsed else -1)
        found["last"].append(first_counter + pulsed[-1] if pulsed else -1)
        found["at_first"].append(x[pulsed[0]] if pulsed else 0)
        found["at_last"].append(x[pulsed[-1]] if pulsed else 0)
    return found


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), frames=st.integers(1, 60), most=st.sampled_from([0, 1, 3, 2420, 65535]))
def test_moments_and_ends_are_those_of_the_definition(seed: int, frames: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, most + 1, (frames, 10)) * (rng.random((frames, 10)) < rng.choice([0.02, 0.5, 1.0]))
    cut = int(rng.integers(0, frames + 1))
    pieces = [{"npp": part.astype(np.uint16)} for part in (counts[:cut], counts[cut:]) if len(part)]
    found = pulse_timing(pieces, 4711)
    assert {name: value.tolist() for name, value in found.items()} == {
        f"npp.{key}": value for key, value in by_hand(counts.tolist(), 4711).items()
    }
    assert {value.dtype for value in found.values()} == {np.dtype(np.int64)}


def test_long_records_at_full_rate_are_exact_to_the_last_digit() -> None:
    """100,000 frames at full rate: beyond what float64 holds; a closed form says what is due."""
    n, each = 100_000, 2420
    found = pulse_timing([{"ppp": np.full((n, 1), each, np.uint16)}], 0)
    assert int(found["ppp.moment1"][0]) == each * n * (n + 1) // 2
    assert int(found["ppp.moment2"][0]) == each * n * (n + 1) * (2 * n + 1) // 6 > 2**53


@pytest.mark.parametrize("flush_each", [1, 3, 1000])
def test_a_records_timing_comes_from_its_own_frames_however_they_arrive(flush_each: int) -> None:
    rng = np.random.default_rng(8)
    npp, ppp = (rng.integers(0, 2, (700, 10)) * (rng.random((700, 10)) < 0.05) for _ in range(2))
    made = constant_stream(npp, ppp, first_counter=65_500)  # the counter wraps inside
    pieces = [((k + 7) * FRAME_NS, made.frames[k : k + 7].tobytes()) for k in range(0, 700, 7)]
    windows = [window(1, 65_510, 300), window(2, 65_810, 300)]
    first, second = cut(pieces, windows, flush_each, timed=True)
    for row, at in ((first, 10), (second, 310)):
        for name, counts in (("npp", npp), ("ppp", ppp)):
            due = by_hand(counts[at : at + 300].tolist(), 65_500 + at)
            assert {key: row.timing[f"{name}.{key}"].tolist() for key in KEYS} == due


@pytest.mark.parametrize("wrong", ["missing", "suspect", "not asked for"])
def test_without_all_of_its_frames_a_record_has_no_timing(wrong: str) -> None:
    made = stream(400)
    keep = np.ones(400, bool)
    if wrong == "missing":
        keep[150] = False
    elif wrong == "suspect":
        made.columns["master_count"][150] *= 2
        made.frames = frame("ngu_a").encode(made.columns, 400)
    decoder, cutter = LinkDecoder(frame("ngu_a")), RecordCutter(frame("ngu_a"))
    cutter.open(window(1, 100, 200), timed=wrong != "not asked for")
    cutter.open(window(2, 300, 50), timed=True)
    decoder.push(400 * FRAME_NS, made.frames[keep].tobytes())
    cutter.feed(decoder.flush())
    hurt, whole = cutter.finished()
    assert hurt.timing == {}
    assert len(whole.timing) == 2 * len(KEYS)
