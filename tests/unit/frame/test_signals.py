"""Signals and their rates, against a struct-by-hand decoder and sums of the counts that were put in."""

import struct
from binascii import crc_hqx
from pathlib import Path

import numpy as np
import pytest
from trend_sample import FRAMES, batch_of

from bench.frame import LinkDecoder, Signal, load_frame, parse_frame, rate_of, signal_of, trailing_means
from bench.frame.signals import MOST_SIGNALS, all_signals, columns, expand
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.record import LinkReduction, sources_of

MANY = """\
frame: many
endian: big
sync: [0xEB, 0x90]
rate: 10 Hz
fields:
  - {name: counter, type: u16, role: counter}
  - {name: wide, type: u8, count: 250}
crc: {name: crc-16/ibm-3740, over: [counter, wide], stored: big}
golden: "GOLDEN"
expect: {counter: 1}
"""


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


def test_where_there_are_too_many_only_those_wanted_remain() -> None:
    checked = bytes([0, 1, *[0] * 250])
    golden = (b"\xeb\x90" + checked + crc_hqx(checked, 0xFFFF).to_bytes(2)).hex()
    definition = parse_frame(MANY.replace("GOLDEN", golden), "many.yaml")
    frames = {**FRAMES, "many": definition}
    names = [signal.name for signal in all_signals(frames, ["port_a.npp[1..3]"])]
    assert len(all_signals({"many": definition})) <= MOST_SIGNALS
    assert names == ["port_a.npp[1]", "port_a.npp[2]", "port_a.npp[3]", "bench.air", "bench.unit", "bench.setpoint"]


ROOT = Path(__file__).resolve().parents[3]
COUNTED = {name: load_frame(ROOT / "frames" / f"{name}.yaml") for name in ("ngu_a", "ngu_a_100s", "imu_200")}
NAMES = ("ngu_a.npp-ppp[3]", "ngu_a.npp-ppp[3]/s", "ngu_a.af_clock/s")


def signals() -> list[Signal]:
    return [signal_of(name, COUNTED) for name in NAMES]


def counted(n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(11)
    return {name: rng.integers(0, 300, n) for name in ("npp", "ppp", "af_clock")}


def test_the_mean_of_the_last_second_is_the_sum_of_what_came_in_it() -> None:
    counts, t_ns = counted(400), np.arange(400) * (NS // 100)
    pulses = counts["npp"] - counts["ppp"]
    values = np.column_stack((pulses, 100.0 * pulses, 100.0 * counts["af_clock"])).astype(float)
    found = trailing_means(t_ns, signals(), values)
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
    reduction = LinkReduction(sources_of(signals(), COUNTED)[0], definition)
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
