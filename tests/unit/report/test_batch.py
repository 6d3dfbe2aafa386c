"""Many sessions as one, the report as PDF, and the timetable: verdicts, yield, figures inside the page."""

import io
import json
import re
import sys
import zlib
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fontTools.ttLib import TTFont
from matplotlib.image import imread
from plan_sample import planned
from report_sample import (
    LIMIT,
    SEED,
    SamplePlan,
    calibrations,
    coupling,
    results,
    sample_model,
    sample_results,
    sample_steps,
)

from bench.analysis import Figure, estimate, series
from bench.analysis import Table as Shown
from bench.model.errors import InputError
from bench.plan import Step, planned_temperature
from bench.report import Report
from bench.report.batch.document import batch_document, batch_html, batch_json
from bench.report.batch.model import Batch, LeftOut, Unit
from bench.report.document import document_files, typeset
from bench.report.fonts import folders
from bench.report.model import ReportModel
from bench.report.plots import plot_timetable
from bench.report.plots.figures import thin
from bench.report.sheet import missing, width_pt
from bench.report.tables import words_of
from bench.report.timetable import timetable

GOOD, BAD = 0.5 * LIMIT, 2.0 * LIMIT


def batch_of(*documents: dict[str, object]) -> Batch:
    found = Batch()
    for document in documents:
        found.add(document, str(document["session"]))
    return found


def outcomes(found: Batch) -> dict[str, str]:
    return {unit.serial: str(outcome) for unit, outcome in found.outcomes.items()}


def test_a_unit_passes_if_no_session_of_it_fails() -> None:
    found = batch_of(
        results("s1", "A", [coupling(GOOD)]),
        results("s2", "A", [coupling(GOOD)], campaign="imu_bias"),
        results("s3", "B", [coupling(GOOD)]),
        results("s4", "B", [coupling(BAD), coupling(GOOD, "y")], campaign="imu_bias"),
        results("s5", "C", [coupling(GOOD)], incomplete=True),
    )
    assert outcomes(found) == {"A": "pass", "B": "fail", "C": "no_result"}
    assert (found.yield_of().passed, found.yield_of().failed, found.yield_of().without) == (1, 1, 1)
    assert found.yield_of().share == 0.5
    by_campaign = {name: found.yield_of(name) for name in found.campaigns}
    assert (by_campaign["imu_bias"].passed, by_campaign["imu_bias"].failed) == (1, 1)
    assert (by_campaign["imu_calibration"].passed, by_campaign["imu_calibration"].without) == (2, 1)


def test_a_unit_of_which_something_is_missing_does_not_pass() -> None:
    """Of one of several units: GPS was not tested. Of a whole session: no hour for the stability."""
    found = Batch()
    several = [coupling(GOOD, unit="A"), coupling(GOOD, unit="A1"), coupling(BAD, unit="C")]
    found.add(results("s1", "BATCH", several), "s1", ["unit A: GPS was not tested", "unit C: GPS was not tested"])
    found.add(results("s2", "D", [coupling(GOOD)]), "s2", ["stability: no record"])
    assert outcomes(found) == {"A": "no_result", "A1": "pass", "C": "fail", "D": "no_result"}
    found = batch_of(results("s1", "A", [coupling(GOOD)]))
    found.without_result({"campaign": {"uut": {"model": "GNC", "serial": "A"}, "analysis": "imu_bias"}}, "s2")
    assert outcomes(found) == {"A": "no_result"}


def test_a_conditional_fail_is_no_pass_and_an_estimate_without_a_limit_is_not_judged() -> None:
    near = {**coupling(GOOD).document, "verdict": "conditional_fail"}
    document = results("s1", "A", [coupling(GOOD)])
    document["estimates"] = [near]
    free = estimate("gyro_bias", "deg/h", 3.0, 1.0, {"axis": "x"}, n=6)
    barely = results("s4", "D", [coupling(GOOD)])
    barely["estimates"] = [{**coupling(GOOD).document, "verdict": verdict} for verdict in ("pass", "conditional_pass")]
    found = batch_of(document, results("s2", "B", [free]), results("s3", "C", []), barely)
    assert outcomes(found) == {"A": "conditional_fail", "B": "not_judged", "C": "no_result", "D": "conditional_pass"}
    assert (found.yield_of().passed, found.yield_of().failed, found.yield_of().without) == (1, 1, 2)


def test_units_of_one_session_and_equal_numbers_of_two_models_are_told_apart() -> None:
    tested = [coupling(GOOD, unit="GNC-1"), coupling(BAD, unit="GNC-2"), coupling(GOOD, unit="GNC-3")]
    found = batch_of(results("s1", "BATCH-1", tested, campaign="gnc_unit_test"))
    assert outcomes(found) == {"GNC-1": "pass", "GNC-2": "fail", "GNC-3": "pass"}
    ((spread),) = found.spreads
    assert len(spread.members) == 3
    assert "unit" not in spread.quantity.where
    other = results("s2", "A", [coupling(BAD)])
    other["uut"]["model"] = "IMU"
    found = batch_of(results("s1", "A", [coupling(GOOD)]), other)
    assert {unit: str(said) for unit, said in found.outcomes.items()} == {
        Unit("GNC", "A"): "pass", Unit("IMU", "A"): "fail",
    }  # fmt: skip


def test_statistics_are_those_of_the_values() -> None:
    documents = calibrations(50)
    values = [
        one["value"]
        for document in documents
        for one in document["estimates"]
        if one["quantity"] == "gyro_scale_error" and one["conditions"]["axis"] == "y"
    ]
    (found,) = [
        one
        for one in batch_document(batch_of(*documents), "test")["quantities"]
        if one["quantity"] == "gyro_scale_error" and one["conditions"]["axis"] == "y"
    ]
    assert (found["n"], found["unit"], found["worst"]) == (50, "ppm", None), f"seed {SEED}"
    assert found["mean"] == pytest.approx(np.mean(values), rel=1e-12)
    assert found["std"] == pytest.approx(np.std(values, ddof=1), rel=1e-12)
    assert found["min"]["value"] == min(values)
    (alone,) = batch_of(results("s1", "A", [coupling(GOOD)])).spreads
    assert alone.std is None
    assert found["max"]["serial"] == documents[int(np.argmax(values))]["uut"]["serial"]


@pytest.mark.parametrize(
    ("values", "u", "worst"),
    [
        ((GOOD, -BAD, 0.9 * LIMIT), (1e-9,) * 3, -BAD),  # the size counts, not the value
        ((0.2 * LIMIT, -0.4 * LIMIT, 0.3 * LIMIT), (1e-9,) * 3, -0.4 * LIMIT),  # all inside: the greatest use
        ((0.9 * LIMIT, 0.8 * LIMIT), (1e-6, 2e-4), 0.8 * LIMIT),  # the other one is certain to be inside
    ],
)
def test_the_worst_is_the_one_most_likely_outside(
    values: tuple[float, ...], u: tuple[float, ...], worst: float
) -> None:
    parts = [coupling(value, u=each) for value, each in zip(values, u, strict=True)]
    found = batch_of(*(results(f"s{n}", f"U{n}", [part]) for n, part in enumerate(parts)))
    assert found.spreads[0].worst.value == found.worst[0][1].value == worst


def test_a_count_that_must_be_zero() -> None:
    counts = [estimate("memory_wrong", "1", n, 0.0, {"item": "memory"}, n=1, limit=0.0) for n in (0.0, 1.0, 2.0)]
    found = batch_of(*(results(f"s{n}", f"U{n}", [one]) for n, one in enumerate(counts)))
    assert outcomes(found) == {"U0": "pass", "U1": "fail", "U2": "fail"}
    assert found.worst[-1][1].unit.serial == "U0"
    json.loads(batch_json(found, "test"))


def test_the_file_says_what_was_added_and_is_the_same_again() -> None:
    documents = calibrations(20)
    text = batch_json(batch_of(*documents), "test 0")
    assert text == batch_json(batch_of(*documents), "test 0")
    found = json.loads(text)
    assert (len(found["units"]), len(found["parts"]), found["simulated"]) == (20, 20, True)
    failed = sum(one["verdict"] == "fail" for one in found["units"])
    assert found["yield"]["units"]["fail"] == failed
    low, high = found["yield"]["units"]["interval_95"]
    assert low < (20 - failed) / 20 <= high


def test_the_page_is_whole_and_watermarked_if_any_session_is_simulated() -> None:
    simulated = batch_html(batch_of(*calibrations(30)), "test 0")
    assert simulated == batch_html(batch_of(*calibrations(30)), "test 0")
    assert "SIMULATED" in simulated
    real = batch_html(batch_of(results("s1", "A", [coupling(GOOD)], simulated=False)), "test 0")
    assert "SIMULATED" not in real
    assert not re.search(r"(?:src|href)=\"(?!#)", simulated)
    for figure in re.findall(r"<svg.*?</svg>", simulated, re.DOTALL):
        ElementTree.fromstring(figure)
    page = batch_html(
        batch_of(results("real", "A", [coupling(GOOD)], simulated=False), results("toy", "B", [coupling(GOOD)])), "t"
    )
    assert "SIMULATED" in page
    assert "Some of the sessions are simulated: toy." in page


def test_units_with_doubt_are_counted() -> None:
    reason = {"code": "lack_of_fit", "sentence": "The levels do not lie on a line.", "figure": 3.0}
    document = results("s2", "B", [coupling(GOOD)])
    document["estimates"][0] |= {
        "expanded_uncertainty": None, "verdict": "indeterminate", "quality": "doubtful", "reasons": [reason]
    }  # fmt: skip
    found = batch_of(results("s1", "A", [coupling(GOOD)]), document)
    assert [unit.serial for unit in found.doubted] == ["B"]
    assert [part["not_sound"] for part in json.loads(batch_json(found, "t"))["parts"]] == [0, 1]
    assert "1 units with doubt" in batch_html(found, "t")


def test_what_was_left_out_stands_on_the_page() -> None:
    found = batch_of(results("s1", "A", [coupling(GOOD)]))
    found.left_out.append(LeftOut("s2", "B-REC-012", "the manifest <is> missing"))
    page = batch_html(found, "test")
    assert "B-REC-012" in page
    assert "the manifest &lt;is&gt; missing" in page


DPI = 60.0
STREAM = re.compile(rb"stream\r?\n(.*?)\r?\nendstream", re.DOTALL)


@pytest.fixture(scope="module")
def report() -> Report:
    return Report(sample_model())


def typeset_pages(report: Report, **more: bool) -> list[bytes]:
    return typeset(document_files(sample_model(**more), report.sections, words_of("en")), format="png", ppi=DPI)


@pytest.fixture(scope="module")
def marked_pages(report: Report) -> list[bytes]:
    return typeset_pages(report)


@pytest.fixture(scope="module")
def pdf(report: Report) -> bytes:
    return report.pdf()


def opened(pdf: bytes) -> bytes:
    """The file with every stream that is packed laid open behind it."""
    for found in STREAM.finditer(pdf):
        with suppress(zlib.error):
            pdf += b"\n" + zlib.decompress(found[1])
    return pdf


def test_same_numbers_same_bytes_and_every_font_and_page_is_inside(
    report: Report, pdf: bytes, marked_pages: list[bytes]
) -> None:
    assert pdf.startswith(b"%PDF-")
    assert report.pdf() == pdf
    inside = opened(pdf)
    assert b"CreationDate" not in inside
    assert b"CreateDate" not in inside
    names = set(re.findall(rb"/FontName\s*/[A-Z]{6}\+([A-Za-z-]+)", inside))
    assert names == {b"DejaVuSans", b"DejaVuSans-Bold"}
    assert len(re.findall(rb"/FontFile[23]?\b", inside)) >= len(names)
    assert f"/Count {len(marked_pages)}".encode() in inside
    assert len(marked_pages) >= 8


def test_a_simulated_run_is_marked_on_every_page_and_a_real_one_on_none(
    report: Report, marked_pages: list[bytes]
) -> None:
    real_pages = typeset_pages(report, simulated=False)  # only the mark on them tells a simulated run
    pale_red = np.array((248.0, 232.0, 235.0)) / 255.0  # 9 % of the red of the mark on white
    for pages, marked in ((marked_pages, True), (real_pages, False)):
        for page in pages:
            away = np.abs(imread(io.BytesIO(page))[..., :3] - pale_red).max(axis=2)
            count = int((away < 3.0 / 255.0).sum())
            assert count > 1000 if marked else count < 100


@pytest.mark.parametrize("language", ["en", "ko"])
def test_every_text_has_its_glyphs(language: str) -> None:
    words = words_of(language)
    assert missing("".join(words.all.values())) == set()
    files = document_files(sample_model(), Report(sample_model(), language).sections, words)
    assert {name for name, raw in files.items() if name != "main" and missing(raw.decode())} == set()


def test_what_a_person_wrote_is_no_markup_and_loses_no_character(no_korean_font: None) -> None:
    results = sample_results() | {"estimates": [], "session": "20000101T000000Z_#panic_한"}
    model = ReportModel(title='*x* $y$ #import "no" \\', results=results, notes=("= not a heading @ref <tag>",))
    report = Report(model)
    frame = json.loads(document_files(model, report.sections, words_of("en"))["report.json"])
    assert frame["title"] == model.title
    assert frame["first"]["number"].endswith("#panic_[U+D55C]")
    assert report.pdf().startswith(b"%PDF-")


def test_without_typst_the_error_names_the_extra(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "typst", None)
    with pytest.raises(InputError, match=r"B-REP-001: .*inertial-bench\[pdf\]"):
        report.pdf()


def test_page_and_paper_have_the_same_sections(report: Report) -> None:
    page = report.html()
    frame = json.loads(document_files(sample_model(), report.sections, words_of("en"))["report.json"])
    titles = [chapter["title"] for chapter in frame["chapters"]]
    assert re.findall(r"<h2>([^<]*)</h2>", page) == titles
    pictures = [picture["file"] for chapter in frame["chapters"] for picture in chapter["pictures"]]
    assert len(pictures) == len(set(pictures)) == page.count("<svg ")


@pytest.mark.parametrize(
    ("place", "file", "bold", "text"),
    [
        (0, "DejaVuSans.ttf", False, "−12\u202f345.678 ± 0.012"),
        (0, "DejaVuSans-Bold.ttf", True, "µΩ°C²∞√·…–—"),
        (1, "NanumGothic.ttf", False, "한"),
        (1, "NanumGothicBold.ttf", True, "한"),
    ],
)
def test_widths_are_those_of_another_reader_of_the_font(place: int, file: str, bold: bool, text: str) -> None:
    with TTFont(folders()[place] / file) as font:
        charmap, advances, units = font.getBestCmap(), font["hmtx"], font["head"].unitsPerEm
    expected = 10.0 * sum(advances[charmap[ord(one)]][0] for one in text) / units
    assert width_pt(text, 10.0, bold) == pytest.approx(expected, rel=1e-6)


def test_without_the_font_paper_is_refused_and_the_page_is_written(no_korean_font: None) -> None:
    model = ReportModel(
        title="T", results={"session": "s", "estimates": []},
        figures=(Figure("한글", "", "x", "y", [series("한", [0.0, 1.0], [0.0, 1.0])]),),
        tables=(Shown("표", "", ["가"], [["나"]]),),
    )  # fmt: skip
    report = Report(model, "ko")
    assert "한글" in report.html()
    with pytest.raises(InputError, match=r"font that is not installed") as caught:
        report.pdf()
    assert caught.value.code == "B-TXT-002"
    assert "inertial-bench[ko]" in caught.value.next_step


def test_bars_cover_exactly_the_planned_time() -> None:
    table = timetable(sample_steps(), prepare_s=600.0)
    assert sum(bar.duration_s for bar in table.bars if bar.kind not in {"prepare", "finally"}) == 136_800.0
    assert table.lanes == ("prepare", "soak", *(f"channel {n}" for n in range(1, 11)), "finally")
    repeat = [bar for bar in table.bars if bar.kind == "repeat"]
    assert [(bar.lane, bar.start_s, bar.duration_s) for bar in repeat] == [("channel 1", 135_000.0, 1800.0)]
    assert len(table.bars) == 1 + 5 + 50 + 1 + 1


def chamber(at_s: float, name: str, temperature: float = 0.0, ramp: float = 0.0) -> Step:
    arguments = {"temperature": temperature, "ramp": ramp} if name == "set_temperature" else {}
    return planned("call", at_s=at_s, role="chamber", name=name, **arguments)


def record(at_s: float, seconds: float) -> Step:
    return planned("record", at_s=at_s, duration_s=seconds)


def corners(*steps: Step, prepare_s: float = 0.0) -> list[tuple[float, float]]:
    t_s, degC = planned_temperature(steps, prepare_s)
    return list(zip(t_s.tolist(), degC.tolist(), strict=True))


def test_commands_to_the_chamber_are_planned_like_soaks_in_every_phase() -> None:
    asked = {"temperature": 3.0, "ramp": 1.0}
    found = corners(
        planned("soak", phase="prepare", at_s=10.0, duration_s=1800.0, **asked),
        record(0.0, 600.0),
        chamber(600.0, "set_temperature", 13.0, 0.5),
        chamber(600.0, "run"),
        record(600.0, 1800.0),
        planned("soak", phase="finally", duration_s=900.0, temperature=23.0, ramp=1.0),
        prepare_s=1810.0,
    )
    assert found == [
        (-1800.0, 23.0), (-600.0, 3.0), (600.0, 3.0), (1800.0, 13.0), (2400.0, 13.0), (3000.0, 23.0), (3300.0, 23.0)
    ]  # fmt: skip


def test_a_set_point_counts_from_run_on_and_a_new_one_at_once() -> None:
    asked = chamber(0.0, "set_temperature", 43.0, 1.0)
    assert corners(asked, record(0.0, 60.0)) == []
    on_the_way = (asked, chamber(60.0, "run"), chamber(660.0, "set_temperature", 23.0, 2.0), record(660.0, 600.0))
    assert corners(*on_the_way) == [(60.0, 23.0), (660.0, 33.0), (960.0, 23.0), (1260.0, 23.0)]


def test_the_ramp_stands_still_on_hold_and_ends_with_stop() -> None:
    begun = (chamber(0.0, "set_temperature", 43.0, 1.0), chamber(0.0, "run"), chamber(300.0, "hold"))
    assert corners(*begun, record(300.0, 60.0)) == [(0.0, 23.0), (300.0, 28.0), (360.0, 28.0)]
    assert corners(*begun, chamber(600.0, "run"), record(600.0, 1200.0))[2:] == [
        (600.0, 28.0), (1500.0, 43.0), (1800.0, 43.0)
    ]  # fmt: skip
    stopped = corners(*begun, chamber(600.0, "stop"), record(600.0, 100.0))
    assert stopped[:-1] == [(0.0, 23.0), (300.0, 28.0), (600.0, 28.0)]
    assert stopped[-1][0] == 600.0
    assert np.isnan(stopped[-1][1])


def test_thinning_keeps_extremes_and_drops_missing_readings() -> None:
    rng = np.random.default_rng(11)
    t_s = np.arange(20_000.0)
    value = rng.normal(20.0, 0.1, t_s.size)
    value[12_345], value[777], value[5:50] = 99.0, -99.0, np.nan
    thin_t_s, thin_value = thin(t_s, value, most=200)
    assert thin_t_s.size <= 200
    assert (thin_value.max(), thin_value.min()) == (99.0, -99.0)
    assert np.all(np.diff(thin_t_s) > 0)
    assert np.array_equal(value[thin_t_s.astype(int)], thin_value)
    assert thin(t_s, np.empty(0))[0].size == 0


def test_same_plan_same_svg(tmp_path: Path) -> None:
    plan = SamplePlan("Scale factor", sample_steps(), 600.0)
    for name in ("a.svg", "b.svg"):
        plot_timetable(plan, tmp_path / name)
    text = (tmp_path / "a.svg").read_text(encoding="utf-8")
    assert text == (tmp_path / "b.svg").read_text(encoding="utf-8")
    assert "Temperature / °C" in text
    assert "Time from hour 0 / h" in text
    assert "<dc:date>" not in text
