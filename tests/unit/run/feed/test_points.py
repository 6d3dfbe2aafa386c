"""Points of 0.1 s against a plain loop over every frame; the state of the bench by its replies."""

import json
import math
import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from run_rig import ROOT

from bench.frame import LinkDecoder, load_frame
from bench.frame.signals import all_signals
from bench.model.clock import NS
from bench.model.events import End
from bench.plan import Findings, graphs_of, load_station, shown_signals
from bench.plan.check.stations import station_rules
from bench.run.feed.bench_state import LAST_LOOK_S, BenchState, bench_in_words
from bench.run.feed.points import KEPT, PATIENCE_NS, PointBatch, Points, moments_ns
from bench.run.feed.scenery import graph_rows, limit_rows, signal_rows

FRAMES = {"port_a": load_frame(ROOT / "frames" / "ngu_a.yaml"), "port_b": load_frame(ROOT / "frames" / "ngu_b.yaml")}
SIGNALS = all_signals(FRAMES, ("port_a.npp-ppp[1..2]", "port_a.npp-ppp[1..2]/s"))
NAMES = [one.name for one in SIGNALS]
ORIGIN_NS, UTC_S = 7 * NS, 1e9


def made() -> Points:
    return Points(SIGNALS, {"port_a": NS // 100, "port_b": NS // 10}, ORIGIN_NS, UTC_S, PATIENCE_NS)


def batch_of(stamps_ns: list[int], npp: np.ndarray, first: int = 0, together: int = 1) -> Any:
    """Frames of port_a decoded from bytes; ``together`` of them have each stamp."""
    decoder, definition = LinkDecoder(FRAMES["port_a"]), FRAMES["port_a"]
    n = len(npp)
    columns = {
        "counter": (first + np.arange(n)) % 65536, "npp": npp, "ppp": np.zeros((n, 10), int), "af_clock": 2560,
        "master_count": 1, "fg_count": 1, "status": 0,
    }  # fmt: skip
    rows = definition.encode(columns, n)
    for number in range(0, n, together):
        decoder.push(stamps_ns[number // together], b"".join(bytes(row) for row in rows[number : number + together]))
    return decoder.flush()


def unpacked(batch: PointBatch, signals: int = len(SIGNALS)) -> tuple[list[float], np.ndarray]:
    """By the words of docs/live-protocol.md, with struct alone."""
    times = list(struct.unpack_from(f"<{batch.n}d", batch.packed))
    values = struct.unpack_from(f"<{2 * batch.n * signals}f", batch.packed, 8 * batch.n)
    assert len(batch.packed) == 8 * batch.n + 8 * batch.n * signals
    return times, np.array(values).reshape(batch.n, signals, 2)


def test_every_frame_is_between_least_and_greatest_of_its_tenth_of_a_second() -> None:
    rng = np.random.default_rng(4)
    print("seed 4")
    points, n = made(), 3000
    npp = rng.integers(0, 60000, (n, 10))
    stamps = [ORIGIN_NS + int(k * NS / 100 + rng.integers(0, 4_000_000)) for k in range(n)]
    for first in range(0, n, 25):
        part = slice(first, first + 25)
        points.on_batch("port_a", batch_of(stamps[part], npp[part], first))
        if first % 500 == 0:
            points.since(0, stamps[first + 24])  # made into points bit by bit or all at once: no difference
    found = points.since(0, stamps[-1])
    times, values = unpacked(found)
    expected: dict[int, list[float]] = {}
    for stamp, row in zip(stamps, npp, strict=True):
        expected.setdefault((stamp - ORIGIN_NS) // (NS // 10), []).append(float(row[1]))
    place = NAMES.index("port_a.npp[2]")
    for number, moment, (least, greatest) in zip(range(found.first, found.seq), times, values[:, place], strict=True):
        assert moment == pytest.approx(UTC_S + number / 10, abs=1e-6)
        assert (least, greatest) == (min(expected[number]), max(expected[number]))
    assert found.seq == (stamps[-1] - ORIGIN_NS) // (NS // 10)
    difference = values[:, NAMES.index("port_a.npp-ppp[2]")]
    assert (difference == values[:, place]).all()


def test_a_rate_is_what_came_in_the_second_before_and_a_gap_stays_a_gap() -> None:
    rng = np.random.default_rng(6)
    print("seed 6")
    npp = rng.integers(0, 500, (600, 10))
    there = np.ones(600, bool)
    there[230:275] = False  # 0.45 s: less than half of a second is missing, and four tenths are empty
    there[400:470] = False
    stamps = np.array([ORIGIN_NS + k * NS // 100 for k in range(600)])
    points = made()
    for first in range(0, 600, 20):
        kept = np.flatnonzero(there[first : first + 20]) + first
        if len(kept):
            points.on_batch("port_a", batch_of(stamps[kept].tolist(), npp[kept], int(kept[0])))
        points.since(0, int(stamps[min(599, first + 19)]))
    found = points.since(0, ORIGIN_NS + 6 * NS)
    rate = unpacked(found)[1][:, NAMES.index("port_a.npp-ppp[2]/s")]
    assert (rate[:, 0] == rate[:, 1])[np.isfinite(rate[:, 0])].all()
    for number in range(10, 59):
        window = np.arange(10 * number - 90, 10 * number + 10)
        kept = window[there[window]]
        empty = not there[10 * number : 10 * number + 10].any()
        if empty or len(kept) <= 50:
            assert math.isnan(rate[number, 0]), number
        else:
            assert rate[number, 0] == pytest.approx(100.0 * npp[kept, 1].sum() / len(kept), rel=1e-6)
    assert math.isnan(rate[42, 0])
    assert math.isnan(rate[47, 0])  # half of its second is missing
    assert np.isfinite(rate[[30, 52], 0]).all()
    assert next(one for one in SIGNALS if one.name == "port_a.npp-ppp[2]/s").unit == "pulse/s"


@pytest.mark.parametrize(("since", "first"), [(0, 200), (799, 799), (800, 800), (801, 200), (-1, 200), (10**12, 200)])
def test_numbers_that_are_gone_or_not_there_yet(since: int, first: int) -> None:
    points = made()
    found = points.since(since, ORIGIN_NS + 80 * NS + PATIENCE_NS)
    assert (found.seq, found.first, found.n) == (800, first, 800 - first)
    assert found.n <= KEPT


def test_a_watcher_who_comes_after_an_hour_sees_the_last_minute_and_memory_does_not_grow() -> None:
    points = made()
    sizes = []
    for second in range(0, 3600, 30):
        stamps = [ORIGIN_NS + second * NS + k * NS // 100 for k in range(3000)]
        points.on_batch("port_a", batch_of(stamps, np.full((3000, 10), second), 100 * second))
        sizes.append(len(points._waiting))
    assert max(sizes) <= 4
    found = points.since(0, ORIGIN_NS + 3600 * NS)
    _, values = unpacked(found)
    assert found.n == KEPT
    newest = values[:, NAMES.index("port_a.npp[1]"), 0]  # the last tenth of the hour is not complete
    assert list(newest) == [3510.0] + [3540.0] * 300 + [3570.0] * 299


def test_temperatures_of_the_bench_stand_until_the_next_reading_for_a_while() -> None:
    points = made()
    points.on_reading(ORIGIN_NS + NS, {"air": 20.0, "setpoint": 50.0})
    points.on_reading(ORIGIN_NS + 2 * NS, {"air": 21.0})
    _, values = unpacked(points.since(0, ORIGIN_NS + 3 * NS + PATIENCE_NS))
    air, unit, setpoint = (values[:, NAMES.index(f"bench.{name}"), 0] for name in ("air", "unit", "setpoint"))
    assert np.isnan(air[:9]).all()
    assert list(air[9:]) == [20.0] * 10 + [21.0] * 11
    assert np.isnan(unit).all()
    _, values = unpacked(points.since(0, ORIGIN_NS + 100 * NS + PATIENCE_NS))
    assert np.isnan(values[-1, NAMES.index("bench.air")]).all()
    assert values[-1, NAMES.index("bench.setpoint"), 1] == 50.0
    assert set(setpoint[9:]) == {50.0}


@pytest.mark.parametrize(
    ("stamps", "period", "expected"),
    [
        ([100, 200, 300], 100, [100, 200, 300]),
        ([300, 300, 300, 600, 600, 600], 100, [100, 200, 300, 400, 500, 600]),
        ([300, 310, 310], 100, [300, 305, 310]),  # they came faster than they were sent: never before the one in front
        ([500, 900, 900], 0, [500, 700, 900]),
    ],
)
def test_frames_received_together_are_laid_one_after_the_other(stamps: Any, period: int, expected: Any) -> None:
    assert moments_ns(np.array(stamps), period).tolist() == expected


def test_a_rehearsal_that_reads_once_a_second_gives_a_point_each_tenth() -> None:
    points = made()
    stamps = [ORIGIN_NS + (second + 1) * NS for second in range(10)]
    npp = np.arange(1000)[:, None] + np.zeros((1, 10), int)
    points.on_batch("port_a", batch_of(stamps, npp, 0, together=100))
    _, values = unpacked(points.since(0, stamps[-1]))
    spans = values[:, NAMES.index("port_a.npp[1]")]
    assert not np.isnan(spans).any()
    assert (spans[1:, 1] - spans[1:, 0] == 9.0).all()


def test_answers_of_the_unit_are_no_points() -> None:
    points = made()
    points.on_batch("port_a", SimpleNamespace(messages={"answer": SimpleNamespace(t_ns=None)}))  # type: ignore[arg-type]
    assert points.since(0, ORIGIN_NS).n == 0


STATION = load_station(ROOT / "stations" / "af_bench_sim.yaml")
GRAPHS = graphs_of(STATION.file.graphs, FRAMES, "port_a")
SHOWN = shown_signals(GRAPHS, FRAMES)
GYRO = {"kind": "gyro", "k0_C": 1.25e-6, "full_scale_A": 0.299}
ACCELEROMETER = {"kind": "accelerometer", "k0_C": 0.1e-6, "full_scale_A": 0.0242}


def manifest(analysis: str = "scale_factor", **channels: dict[str, Any]) -> dict[str, Any]:
    entries = [{"number": int(name[1:]), **channel} for name, channel in channels.items()]
    return {"measurement_link": "port_a", "campaign": {"analysis": analysis, "channels": entries}}


def test_rates_are_currents_of_the_channels_that_the_campaign_declares() -> None:
    gyros, accelerometers, temperature = graph_rows(GRAPHS, SHOWN, manifest(c1=GYRO, c3=GYRO, c7=ACCELEROMETER))
    assert gyros["rates"]["signals"] == ["port_a.npp-ppp[1]/s", "port_a.npp-ppp[3]/s"]
    assert (gyros["rates"]["unit"], gyros["rates"]["decimals"], gyros["rates"]["mean_s"]) == ("mA", 3, 1.0)
    assert 8000 * gyros["rates"]["factors"][0] == pytest.approx(10.0)  # 10 mA are 8000 pulses of 1.25 uC in a second
    assert 100_000 * accelerometers["rates"]["factors"][0] == pytest.approx(10.0)
    assert accelerometers["rates"]["decimals"] == 4
    assert temperature["rates"] is None
    assert list(gyros["signals"]) == [f"port_a.npp-ppp[{channel}]" for channel in range(1, 7)]


@pytest.mark.parametrize(
    "without", [manifest(), manifest("north", c1=GYRO), manifest(c1={"kind": "gyro"}), {"measurement_link": "port_a"}]
)
def test_without_what_a_pulse_stands_for_a_rate_is_in_pulses(without: dict[str, Any]) -> None:
    rates = graph_rows(GRAPHS, SHOWN, without)[0]["rates"]
    assert (rates["unit"], rates["factors"], len(rates["signals"])) == ("pulse/s", [1.0] * 6, 6)


def test_a_signal_names_the_channel_it_counts() -> None:
    rows = {row["name"]: row["channel"] for row in signal_rows(SHOWN, manifest(c3=GYRO))}
    assert rows["port_a.npp-ppp[3]/s"] == rows["port_a.npp[3]"] == {"number": 3, "kind": "gyro"}
    assert rows["port_a.ppp[4]"] == {"number": 4, "kind": None}
    assert rows["port_b.unit_temperature[1]"] is None
    assert rows["port_a.af_clock"] is None


def test_limits_are_those_that_the_station_and_its_guard_have() -> None:
    rows = limit_rows(station_rules(STATION, Findings()).values(), STATION.guard_limits_degC)
    assert [(row["name"], row["of"], row["low_degC"], row["high_degC"]) for row in rows] == [
        ("chamber_air", "air", -43.0, 63.0), ("second_air", "air", None, 63.0), ("unit_hot", "unit", None, 65.0),
        ("guard", "air", None, 65.0), ("guard", "unit", None, 70.0),
    ]  # fmt: skip
    assert {row["action"] for row in rows} == {"abort", "guard"}


GOOD_FOR_S = 150.0
PLACES = {
    "calibrator": ("fluke_5720a", "GPIB0::4::INSTR"),
    "switch": ("keithley_7002", "GPIB0::7::INSTR"),
    "supply": ("hp_6632b", "GPIB0::5::INSTR"),
    "chamber": ("thermotron_3800", "GPIB0::1::INSTR"),
    "dmm": ("hp_3458a", "GPIB0::22::INSTR"),
}
OFF = (
    ("calibrator", "ISR?", "0"), ("switch", ":CLOS:STAT?", "(@)"), ("supply", "OUTP?", "0"), ("chamber", "MODE?", "0"),
)  # fmt: skip


END = End(steps=1, records=1, slip_s=0.0, overruns=0, retaken=0, lateness_ms=[0.0, 0.0, 0.0], error=None)


def bench() -> BenchState:
    return BenchState(PLACES, GOOD_FOR_S)


def asked(outputs: BenchState, role: str, question: str, reply: str, t: float) -> None:
    outputs.on_traffic(role, "tx", question, t)
    outputs.on_traffic(role, "rx", reply, t + 0.01)


def all_off(t: float = 0.0) -> BenchState:
    outputs = bench()
    for line in OFF:
        asked(outputs, *line, t)
    return outputs


def parts(document: dict[str, Any]) -> dict[str, str]:
    return {part["role"]: part["state"] for part in document["parts"]}


def test_all_are_off_when_the_last_of_them_has_said_so_and_nothing_is_known_before() -> None:
    outputs = bench()
    document = outputs.document(0.0)
    assert (document["state"], document["confirmed_utc_s"]) == ("unknown", None)
    assert parts(document) == dict.fromkeys(("calibrator", "switch", "supply", "chamber"), "unknown")  # a meter reads
    for number, line in enumerate(OFF):
        assert outputs.document(float(number))["state"] == "unknown"
        asked(outputs, *line, float(number))
    document = outputs.document(4.0)
    assert (document["state"], document["confirmed_utc_s"]) == ("off", pytest.approx(0.01))  # the oldest of the replies
    json.dumps(document, allow_nan=False)


def test_a_command_switches_on_at_once_and_off_only_when_that_is_confirmed() -> None:
    outputs = all_off()
    outputs.on_traffic("calibrator", "tx", "OPER", 1.0)
    assert outputs.document(1.0)["state"] == "energised"
    asked(outputs, "calibrator", "ISR?", str(1 | 1 << 12), 2.0)
    asked(outputs, "calibrator", "OUT?", "2.0E-02,A,0E+00", 2.0)
    document = outputs.document(3.0)
    assert (document["state"], document["confirmed_utc_s"]) == ("energised", pytest.approx(2.01))
    assert bench_in_words(document) == "ENERGISED: calibrator 20 mA"
    outputs.on_traffic("calibrator", "tx", "STBY", 4.0)
    assert outputs.document(4.0)["state"] == "energised"
    asked(outputs, "calibrator", "ISR?", "0", 5.0)
    assert outputs.document(5.0)["state"] == "off"


def test_a_closed_route_is_told_and_is_no_energy_of_its_own() -> None:
    outputs = all_off()
    asked(outputs, "switch", ":CLOS:STAT?", "(@1!2!7)", 1.0)
    document = outputs.document(1.0)
    assert (document["state"], parts(document)["switch"]) == ("off", "on")
    assert document["parts"][1]["figures"][0]["text"] == "1!2!7"


def test_a_reply_that_is_too_old_is_not_known_any_more() -> None:
    outputs = all_off()
    assert outputs.document(GOOD_FOR_S)["state"] == "off"
    assert outputs.document(GOOD_FOR_S + 0.1)["state"] == "unknown"
    asked(outputs, "supply", "OUTP?", "1", 200.0)
    assert outputs.document(200.0 + GOOD_FOR_S)["state"] == "energised"
    assert outputs.document(201.0 + GOOD_FOR_S)["state"] == "unknown"


def test_the_end_counts_by_its_last_look() -> None:
    outputs = all_off(1000.0)
    outputs.on_event(END, 1001.0)
    assert outputs.document(9e6)["state"] == "off"
    asked(outputs, "calibrator", "ISR?", "0", 1000.0 + LAST_LOOK_S)
    outputs.on_event(END, 1001.0 + LAST_LOOK_S)
    late = outputs.document(9e6)  # only the calibrator has answered at the end
    assert late["state"] == "unknown"
    assert parts(late) == {"calibrator": "off", "switch": "unknown", "supply": "unknown", "chamber": "unknown"}


def test_a_command_of_nobodys_table_and_a_reply_of_another_form_make_it_unknown() -> None:
    outputs = all_off()
    outputs.on_traffic("supply", "tx", "OUTP 1", 1.0)  # by hand, in a form that the driver does not use
    assert parts(outputs.document(1.0))["supply"] == "unknown"
    asked(outputs, "supply", "OUTP?", "1", 2.0)
    assert parts(outputs.document(2.0))["supply"] == "on"
    asked(outputs, "supply", "OUTP?", "what?", 3.0)
    assert parts(outputs.document(3.0))["supply"] == "unknown"


def test_a_chamber_on_hold_is_not_told_as_running_and_its_heat_stays() -> None:
    outputs = all_off()
    asked(outputs, "chamber", "MODE?", str(1 << 4), 1.0)
    asked(outputs, "chamber", "PVAR1?", "55.0", 1.0)
    document = outputs.document(1.0)
    assert (document["state"], document["remains"]) == ("energised", ["mains", "hot"])
    asked(outputs, "chamber", "MODE?", str(1 << 4 | 1 << 3), 2.0)
    document = outputs.document(2.0)
    assert (document["state"], document["remains"]) == ("off", ["mains", "hot"])
    assert [figure["text"] for figure in document["parts"][3]["figures"]] == ["on hold", "55 degC"]
    asked(outputs, "chamber", "PVAR1?", "-20.0", 3.0)
    assert outputs.document(3.0)["remains"] == ["mains", "cold"]


def test_a_table_moves_while_an_interlock_is_closed_or_an_axis_turns() -> None:
    outputs = BenchState({"table": ("acutrol_3000", "GPIB0::9::INSTR")}, GOOD_FOR_S)
    for axis in (1, 2, 3):
        asked(outputs, "table", f":int? {axis}", "Open", 0.0)
        asked(outputs, "table", f":read:rate? {axis}", "0.0", 0.0)
    assert outputs.document(0.0)["state"] == "off"
    asked(outputs, "table", ":int? 2", "Closed", 1.0)
    assert outputs.document(1.0)["state"] == "moving"
    asked(outputs, "table", ":int? 2", "Open", 2.0)
    asked(outputs, "table", ":read:rate? 3", "-12.5", 2.0)  # it coasts
    document = outputs.document(2.0)
    assert document["state"] == "moving"
    assert "rate of axis 3 -12.5 deg/s" in bench_in_words(document)


def test_a_bench_whose_drivers_are_not_here_is_not_known() -> None:
    outputs = BenchState({"thing": ("no_such_driver", "X")}, GOOD_FOR_S)
    asked(outputs, "thing", "OUTP?", "0", 0.0)
    assert outputs.document(0.0)["state"] == "unknown"
