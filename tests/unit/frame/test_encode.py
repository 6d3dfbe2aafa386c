"""The encoder refuses what does not fit; payloads against bytes by hand; signals and their rates against sums."""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, seed
from hypothesis import strategies as st
from record_sample import ROOT, frame
from trend_sample import FRAMES, batch_of

from bench.frame import (
    FrameDefinition,
    LinkDecoder,
    load_frame,
    parse_frame,
    rate_of,
    signal_of,
    trailing_means,
)
from bench.frame.commands import PayloadLayout
from bench.frame.signals import all_signals, columns, expand
from bench.model.clock import NS
from bench.model.errors import InputError, InputErrors
from bench.record import LinkReduction, sources_of

GOOD: dict[str, Any] = {
    "counter": 1, "npp": 2, "ppp": 3, "af_clock": 4, "master_count": 5, "fg_count": 6, "status": 0,
}  # fmt: skip


def columns_refused(columns: dict[str, Any], port: str = "a", message: str = "frame") -> str:
    with pytest.raises(InputError) as caught:
        frame(f"ngu_{port}").encode(columns, 4, message)
    return caught.value.code


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"af_clock": 1 << 24}, "B-FRAME-021"),
        ({"counter": -1}, "B-FRAME-021"),
        ({"npp": np.full((4, 10), 65536)}, "B-FRAME-021"),
        ({"npp": np.full((4, 10), 0.5)}, "B-FRAME-021"),
        ({"status": None, "status.mode": 16}, "B-FRAME-021"),
        ({"ppp": None}, "B-FRAME-020"),
        ({"nothing": 1}, "B-FRAME-022"),
        ({"npp": np.zeros((4, 9), int)}, "B-FRAME-020"),
        ({"counter": np.zeros(3, int)}, "B-FRAME-020"),
    ],
)
def test_wrong_columns(change: dict[str, Any], code: str) -> None:
    assert columns_refused({name: value for name, value in (GOOD | change).items() if value is not None}) == code


def test_what_is_missing_unknown_or_too_long_is_refused() -> None:
    assert columns_refused(GOOD, message="housekeeping") == "B-FRAME-023"
    assert columns_refused({"command": 1, "payload": b""}, "b", "command") == "B-FRAME-020"
    with pytest.raises(InputError, match="B-FRAME-020"):
        frame("ngu_b").encode_one({"command": 1}, "command")
    frame("ngu_b").encode_one({"command": 1, "payload": bytes(248)}, "command")
    with pytest.raises(InputError, match="B-FRAME-021"):
        frame("ngu_b").encode_one({"command": 1, "payload": bytes(249)}, "command")
    batch = frame("ngu_a").decoder().feed(b"").messages["frame"]
    for name in ("np", "status.model", "counter.x"):
        with pytest.raises(InputError, match="B-FRAME-022"):
            batch.raw(name)


def test_named_bits_broadcast_values_and_whole_floats_make_fields() -> None:
    columns = {name: value for name, value in GOOD.items() if name != "status"}
    rows = frame("ngu_a").encode(columns | {"status.mode": np.array([0, 1, 2, 15]), "status.over_range": 513}, 4)
    assert rows[:, 53].tolist() == [0x04, 0x14, 0x24, 0xF4]
    assert rows[:, 54].tolist() == [0x02] * 4
    rows = frame("ngu_a").encode(GOOD | {"counter": np.array([1.0, 2.0, 3.0, 65535.0]), "npp": np.arange(10)}, 4)
    batch = frame("ngu_a").decoder().feed(rows.tobytes()).messages["frame"]
    assert batch.raw("counter").tolist() == [1, 2, 3, 65535]
    assert batch.raw("npp").tolist() == [list(range(10))] * 4


GNC = frame("gnc_422")

REFUSED = yaml.safe_load(Path(__file__).with_name("commands_refused.yaml").read_text(encoding="utf-8"))
HAND_WRITTEN = yaml.safe_load((ROOT / "tests" / "golden" / "gnc_422.commands.yaml").read_text(encoding="utf-8"))
COMMANDS = [(name, *case) for name, case in HAND_WRITTEN.items()]


def close(found: Any, due: Any) -> bool:
    if isinstance(due, list):
        return len(found) == len(due) and all(map(close, found, due))
    if isinstance(due, float):
        return isinstance(found, float) and math.isclose(found, due, rel_tol=1e-12, abs_tol=1e-15)
    return bool(found == (due.hex() if isinstance(due, bytes) else due))


@pytest.mark.validates("payloads of the commands of frames/gnc_422.yaml", against="bytes written by hand")
@pytest.mark.parametrize("case", COMMANDS, ids=[case[0] for case in COMMANDS])
def test_every_command_against_bytes_written_by_hand(case: tuple[Any, ...]) -> None:
    name, code, timeout_s, request, sent, answer, received = case
    layout = GNC.commands[name]
    assert (layout.code, layout.timeout_s, layout.name) == (code, timeout_s, name)
    assert layout.encode(request) == bytes.fromhex(sent)
    assert layout.answer.encode(answer) == bytes.fromhex(received)
    for found, due in ((layout.decode(bytes.fromhex(received)), answer),
                       (layout.request.decode(bytes.fromhex(sent)), request)):  # fmt: skip
        assert list(found) == list(due)
        assert all(close(found[key], due[key]) for key in due), found


def test_no_command_is_without_hand_written_bytes() -> None:
    assert [case[0] for case in COMMANDS] == list(GNC.commands)


def test_a_quantity_with_a_unit_is_converted() -> None:
    start, timer = GNC.commands["stream_start"], GNC.commands["timer"]
    assert start.encode({"sensors": 7, "rate": "0.2 kHz", "samples": 0}) == bytes.fromhex("07c80000000000")
    assert timer.encode({"setting_us": "5 ms", "ticks": 20}) == bytes.fromhex("8813000014")
    assert timer.encode({"setting_us": "0.005 s", "ticks": np.uint8(20)}) == bytes.fromhex("8813000014")


def code_of(layout: PayloadLayout, values: dict[str, Any]) -> str:
    with pytest.raises(InputError) as caught:
        layout.encode(values)
    return caught.value.code


@pytest.mark.parametrize(("name", "values", "code"), REFUSED["values"])
def test_what_does_not_fit_is_refused(name: str, values: dict[str, Any], code: str) -> None:
    assert code_of(GNC.commands[name].request, values) == code


@pytest.mark.parametrize(("name", "payload"), [("stream_stop", "80bb00"), ("stream_stop", "80bb000000"), ("can", "ff")])
def test_an_answer_of_another_length_is_refused_and_none_is_padded_or_cut(name: str, payload: str) -> None:
    answer = {"protocol": 1, "board_serial": "00" * 11, "unit_serial": "00" * 12, "firmware": 1}
    assert code_of(GNC.commands["identify"].answer, answer) == "B-FRAME-021"
    with pytest.raises(InputError, match=r"B-FRAME-025: .*bytes, (at least )?4 are due"):
        GNC.commands[name].decode(bytes.fromhex(payload))


@seed(1)
@given(values=st.lists(st.integers(-32768, 32767), min_size=3, max_size=3), rate=st.integers(0, 65535))
def test_every_step_of_a_scaled_field_comes_back(values: list[int], rate: int) -> None:
    layout = GNC.commands["set_magnetometer"].request
    wire = np.array([*values, rate - 32768, -1], "<i2").tobytes()
    assert layout.encode(layout.decode(wire)) == wire
    assert GNC.commands["stream_start"].encode({"sensors": 0, "rate": rate, "samples": 1})[1:3] == rate.to_bytes(
        2, "little"
    )


def with_commands(commands: str, text: str = GNC.text) -> FrameDefinition:
    return parse_frame(text.partition("\ncommands:")[0] + "\ncommands:\n  " + commands, "sample.yaml")


def refused(commands: str, text: str = GNC.text) -> set[str]:
    with pytest.raises(InputErrors) as caught:
        with_commands(commands, text)
    assert all(error.where.startswith("sample.yaml:") for error in caught.value.errors)
    return {error.code for error in caught.value.errors}


@pytest.mark.parametrize(("commands", "code"), REFUSED["definitions"])
def test_mistakes_in_commands(commands: str, code: str) -> None:
    assert refused(commands) == {code}


def test_commands_need_the_messages_they_travel_in() -> None:
    assert refused("{a: {code: 1}}", frame("ngu_b").text) == {"B-FRAME-014"}
    assert refused("{a: {code: 1}}", frame("ngu_a").text) == {"B-FRAME-014"}


def test_a_default_of_a_command_is_sent_where_nothing_is_given() -> None:
    fields = "[{name: n, type: i16, scale: 0.5, default: -2}, {name: f, type: f32, endian: big}]"
    layout = with_commands(f"{{a: {{code: 1, timeout: 250 ms, request: {fields}}}}}").commands["a"]
    assert layout.timeout_s == 0.25
    assert layout.encode({"f": 1.5}) == bytes.fromhex("feff3fc00000")
    assert layout.encode({"n": 3, "f": -2}) == bytes.fromhex("0600c0000000")
    assert layout.request.decode(bytes.fromhex("feff3fc00000")) == {"n": -1.0, "f": 1.5}
    assert code_of(layout.request, {"f": 1e300}) == "B-FRAME-021"


def test_commands_and_silence_are_part_of_the_hash() -> None:
    plain = with_commands("{a: {code: 1}}").sha256
    assert with_commands("{a: {code: 1, timeout: 200 ms}}").sha256 == plain
    assert with_commands("{a: {code: 2}}").sha256 != plain
    assert with_commands("{a: {code: 1, timeout: 1 s}}").sha256 != plain
    assert with_commands("{a: {code: 1, answer: [{name: n, type: u8}]}}").sha256 != plain
    assert with_commands("{a: {code: 1}}", GNC.text.replace("silence: 50 ms", "silence: 60 ms")).sha256 != plain
    assert with_commands("{a: {code: 1}}", GNC.text.replace("default: 0x10", "default: 0x11")).sha256 != plain


@pytest.mark.parametrize(
    ("name", "sha256"),
    [
        ("ngu_a", "0eee4dee414d7792"),
        ("ngu_a_100s", "9c86b343e651c5dd"),
        ("ngu_b", "abc7e1af12d109e9"),
        ("vn100_binary", "d2bc1f926f081e8e"),
    ],
)
def test_hashes_of_formats_that_sessions_hold_do_not_change(name: str, sha256: str) -> None:
    assert frame(name).sha256[:16] == sha256


def test_an_offset_is_taken_off_and_added_again_and_wide_integers_are_exact() -> None:
    fields = "[{name: t, type: i16, scale: 0.0625, offset: -5, unit: degC}, {name: n, type: u64}]"
    layout = with_commands(f"{{a: {{code: 1, request: {fields}}}}}").commands["a"].request
    wire = bytes.fromhex("9001") + ((1 << 64) - 1).to_bytes(8, "little")
    assert layout.encode({"t": "20 degC", "n": (1 << 64) - 1}) == wire
    assert layout.decode(wire) == {"t": 20.0, "n": (1 << 64) - 1}


@pytest.mark.parametrize("kind", ["u2", "i4", "i8", "u8", ">i4", "f8"])
def test_values_of_every_type_are_written_as_by_hand_or_refused(kind: str) -> None:
    """Both ends of what the fields hold and beyond, of one value for all frames and of one for each."""
    definition, sizes = (
        load_frame(Path(__file__).with_name("types.yaml")),
        {"narrow": 1, "odd": 3, "signed": 3, "wide": 4, "pair": 3},
    )
    for name, size in sizes.items():
        low, high = (-(1 << 23), (1 << 23) - 1) if name == "signed" else (0, (1 << 8 * size) - 1)
        order = "big" if name in ("narrow", "odd") else "little"
        for value in {low, high, low - 1, high + 1, -1, 1 << 33}:
            wanted = np.int64(value).astype(kind).item()
            for shape in ((), (3,), (3, 2)) if name == "pair" else ((), (3,)):
                if name == "pair" and shape == (3,):
                    continue
                columns: dict[str, Any] = dict.fromkeys(sizes, 0) | {name: np.full(shape, wanted, kind)}
                if not low <= wanted <= high:
                    with pytest.raises(InputError, match="B-FRAME-021"):
                        definition.encode(columns, 3)
                    continue
                wire = int(wanted).to_bytes(size, order, signed=wanted < 0)  # type: ignore[arg-type]
                body = b"".join((wire if one == name else bytes(n)) * (1 + (one == "pair")) for one, n in sizes.items())
                check = bytes([int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))])
                assert definition.encode(columns, 3).tobytes() == (b"\xa5" + body + check) * 3


def test_what_streams_is_a_signal_with_its_unit_and_a_range_stands_for_its_elements() -> None:
    assert expand("port_a.npp-ppp[2..4]") == ("port_a.npp-ppp[2]", "port_a.npp-ppp[3]", "port_a.npp-ppp[4]")
    assert expand("port_b.supply_voltage") == ("port_b.supply_voltage",)
    names = [signal.name for signal in all_signals(FRAMES, ["port_a.npp-ppp[1..2]"])]
    assert names[:2] == ["port_a.npp[1]", "port_a.npp[2]"]
    assert names[-5:] == ["port_a.npp-ppp[1]", "port_a.npp-ppp[2]", "bench.air", "bench.unit", "bench.setpoint"]
    fields = {name.partition(".")[2].partition("[")[0] for name in names}
    assert not fields & {"counter", "status", "length", "kind", "payload", "command"}
    assert len(names) == len(set(names)) == 10 + 10 + 3 + 4 + 2 + 3 + 2 + 3
    voltage, sensor = (signal_of(name, FRAMES) for name in ("port_b.supply_voltage", "port_b.unit_temperature[3]"))
    assert (voltage.unit, voltage.decimals, voltage.element) == ("V", 3, None)
    assert (sensor.unit, sensor.decimals, sensor.element) == ("degC", 2, 3)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("port_a.nnp[1]", "no number 'nnp'"),
        ("port_c.npp[1]", "no link 'port_c'"),
        ("port_a.npp[11]", "elements are 1 to 10"),
        ("port_b.supply_voltage[1]", "single value"),
        ("port_a.npp-af_clock[1]", "to be subtracted"),
        ("npp", "not written as"),
    ],
)
def test_a_wrong_name_says_what_is_wrong(name: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        all_signals(FRAMES, [name])
    assert caught.value.code == "B-FRAME-024"


def test_columns_are_what_the_bytes_say() -> None:
    definition = FRAMES["port_a"]
    count, rng = 7, np.random.default_rng(11)
    sent = {"npp": rng.integers(0, 65536, (count, 10)), "ppp": rng.integers(0, 65536, (count, 10))}
    sent["npp"][0, 2], sent["ppp"][0, 2] = 0, 65535  # the largest difference there is
    sent["npp"][1, 2], sent["ppp"][1, 2] = 65535, 0
    raw = definition.encode(
        {"counter": np.arange(count), **sent, "af_clock": 2560, "master_count": 5, "fg_count": 9, "status": 0}, count
    )
    batch = batch_of(definition, raw.tobytes(), 1.0).messages["frame"]
    signals = all_signals(FRAMES, ["port_a.npp-ppp[3]"])
    wanted = [signal for signal in signals if signal.name in ("port_a.npp[3]", "port_a.ppp[3]", "port_a.npp-ppp[3]")]
    found = columns(wanted, "port_a", batch)
    for row, content in enumerate(raw):
        counts = struct.unpack_from(">20H", content.tobytes(), 4)
        npp, ppp = counts[2], counts[12]
        assert found[row].tolist() == [npp, ppp, npp - ppp]


def test_where_there_are_too_many_only_those_wanted_remain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.frame.signals.MOST_SIGNALS", 20)
    names = [signal.name for signal in all_signals(FRAMES, ["port_a.npp[1..3]"])]
    assert len(all_signals({"port_a": FRAMES["port_a"]})) <= 20
    assert names == ["port_a.npp[1]", "port_a.npp[2]", "port_a.npp[3]", "bench.air", "bench.unit", "bench.setpoint"]


COUNTED = {name: load_frame(ROOT / "frames" / f"{name}.yaml") for name in ("ngu_a", "ngu_a_100s", "imu_200")}
SIGNALS = [signal_of(name, COUNTED) for name in ("ngu_a.npp-ppp[3]", "ngu_a.npp-ppp[3]/s", "ngu_a.af_clock/s")]


def counted(n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(11)
    return {name: rng.integers(0, 300, n) for name in ("npp", "ppp", "af_clock")}


def test_the_mean_of_the_last_second_is_the_sum_of_what_came_in_it() -> None:
    counts, t_ns = counted(400), np.arange(400) * (NS // 100)
    pulses = counts["npp"] - counts["ppp"]
    values = np.column_stack((pulses, 100.0 * pulses, 100.0 * counts["af_clock"])).astype(float)
    found = trailing_means(t_ns, SIGNALS, values)
    assert (found[:, 0] == pulses).all()
    assert found[250, 1] == pytest.approx(pulses[151:251].sum())
    assert found[399, 2] == pytest.approx(counts["af_clock"][300:].sum())
    assert np.isnan(found[:50, 1]).all()
    assert np.isfinite(found[50:, 1]).all()


def test_a_second_of_the_trend_has_the_rate_of_its_frames() -> None:
    n, definition = 350, COUNTED["ngu_a"]
    counts = counted(n)
    columns = {
        "counter": np.arange(n), "npp": np.tile(counts["npp"][:, None], (1, 10)),
        "ppp": np.tile(counts["ppp"][:, None], (1, 10)), "af_clock": counts["af_clock"], "master_count": 1,
        "fg_count": 1, "status": 0,
    }  # fmt: skip
    decoder = LinkDecoder(definition)
    for number, row in enumerate(definition.encode(columns, n)):
        decoder.push(round((number + 1) * NS / 100), bytes(row))
    reduction = LinkReduction(sources_of(SIGNALS, COUNTED)[0], definition)
    reduction.push(decoder.flush())
    rows = reduction.rows(0)
    assert rows is not None
    assert rows.start_s.tolist() == [0, 1, 2, 3]
    pulses = counts["npp"] - counts["ppp"]
    for second in range(3):
        of_second = slice(100 * second, 100 * second + 100)
        assert rows.low[second, 0] == pulses[of_second].min()
        assert rows.low[second, 1] == rows.high[second, 1] == pulses[of_second].sum()
        assert rows.low[second, 2] == counts["af_clock"][of_second].sum()
    assert np.isnan(rows.low[3, 1:]).all()  # half of it is not there
    assert np.isfinite(rows.low[3, 0])


def test_only_what_is_counted_per_frame_and_often_has_a_rate() -> None:
    assert rate_of(signal_of("ngu_a_100s.npp[1]", COUNTED), COUNTED) is None
    assert rate_of(signal_of("imu_200.delta_angle[1]", COUNTED), COUNTED) is None
    with pytest.raises(InputError, match="per: frame"):
        signal_of("imu_200.delta_angle[1]/s", COUNTED)
    rate = rate_of(signal_of("ngu_a.npp[1]", COUNTED), COUNTED)
    assert rate is not None
    assert (rate.unit, rate.rate_Hz, rate.decimals) == ("pulse/s", 100.0, 0)
