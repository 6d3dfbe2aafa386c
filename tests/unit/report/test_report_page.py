"""The report page: complete, self-contained, legible, the same bytes for the same numbers, and never too proud."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import pytest
from report_sample import sample_model, sample_results, small_model

from bench.model.quality import Quality
from bench.report import Report
from bench.report.model import ReportModel
from bench.report.plots.style import GREY, INK, MARKERS, PALETTE
from bench.report.verdict_tables import verdict_counts

WATERMARK = "SIMULATED — not a calibration"


class Outline(HTMLParser):
    """Checks nesting, collects ids, references and the text of table cells."""

    VOID = ("meta", "br", "link", "img", "hr", "wbr")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.rows: list[list[str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in {"td", "th"}:
            self.rows[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.ids.append(value)
            if name in {"href", "xlink:href"} and value:
                self.references.append(value)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in {"td", "th"}:
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def model() -> ReportModel:
    return sample_model()


@pytest.fixture(scope="module")
def page(model: ReportModel) -> str:
    return Report(model).html()


@pytest.fixture(scope="module")
def outline(page: str) -> Outline:
    parser = Outline()
    parser.feed(page)
    assert parser.open == []
    return parser


@pytest.fixture(scope="module")
def small() -> ReportModel:
    return small_model()


@pytest.fixture(scope="module")
def small_page(small: ReportModel) -> str:
    return Report(small).html()


@pytest.fixture(scope="module")
def plain() -> ReportModel:
    """A report without any figure: what is not drawn is quick."""
    results = {"session": "s", "campaign": "c", "uut": {}, "estimates": [], "quality": {}, "provenance": {}}
    return ReportModel(title="Empty", results=results)


def test_same_numbers_same_bytes(small_page: str) -> None:
    assert Report(small_model()).html() == small_page


def by_key(value: Any) -> Any:
    """The same document with the keys of every mapping in order of the alphabet, as a session stores them."""
    if isinstance(value, dict):
        return {key: by_key(value[key]) for key in sorted(value)}
    return [by_key(one) for one in value] if isinstance(value, list | tuple) else value


def test_order_of_keys_in_the_session_does_not_matter(small: ReportModel, small_page: str) -> None:
    stored = {name: by_key(getattr(small, name)) for name in ("campaign", "standards", "identities")}
    listed = {name: tuple(by_key(one) for one in getattr(small, name)) for name in ("prompts", "components")}
    origin = {name: by_key(value) for name, value in small.origin.items()}
    assert Report(replace(small, origin=origin, **stored, **listed)).html() == small_page


def test_another_number_another_page(small: ReportModel, small_page: str) -> None:
    first, *others = small.results["estimates"]
    results = {**small.results, "estimates": [{**first, "value": first["value"] + 1.0}, *others]}
    assert Report(replace(small, results=results)).html() != small_page


def test_page_needs_nothing_else(page: str, outline: Outline) -> None:
    assert "<script" not in page
    assert not re.search(r"url\((?!#)", page)
    assert not re.search(r"<(?:img|link|iframe|object)\b", page)
    assert all(reference.startswith("#") for reference in outline.references)
    assert {reference[1:] for reference in outline.references} <= set(outline.ids)


def test_ids_are_unique(outline: Outline) -> None:
    assert len(outline.ids) == len(set(outline.ids))


def test_no_date_and_no_version_of_the_drawing(page: str) -> None:
    assert "dc:date" not in page
    assert not re.search(r"matplotlib\W+(?:v|version)?\d", page, re.IGNORECASE)


def test_every_section_is_there(outline: Outline) -> None:
    sections = [name for name in outline.ids if "-" not in name or name == "scale-factor"]
    assert sections == [
        *("summary", "scale-factor", "coefficients", "others", "uncertainty", "environment", "quality"),
        *("run", "prompts", "standards", "notes", "residuals", "budgets", "provenance"),
    ]


def test_sections_without_content_are_left_out(plain: ReportModel) -> None:
    text = Report(plain).html()
    assert '<section id="summary">' in text
    assert '<section id="residuals">' not in text
    assert "<svg" not in text


def test_what_the_results_rest_on_is_an_annex_with_letters(small_page: str) -> None:
    titles = re.findall(r"<h2>(.*?)</h2>", small_page)
    lettered = [title for title in titles if re.match(r"[A-Z]  ", title)]
    assert lettered == titles[-len(lettered) :]
    assert [title[0] for title in lettered] == list("AB")
    assert lettered[0] == "A  Uncertainty budgets and correlations"
    assert small_page.index('aria-level="2">Annex<') < small_page.index("A  Uncertainty budgets and correlations</h2>")


def test_table_shows_ppm_microampere_and_the_unit_of_the_sensor(model: ReportModel, outline: Outline) -> None:
    estimate = model.estimates("dsf_n")[0]
    row = next(row for row in outline.rows if row[:2] == ["1", "−10.0"])
    headers = next(row for row in outline.rows if row[:2] == ["channel", "set / °C"])
    shown = {name: value.replace("−", "-").replace("\u202f", "") for name, value in zip(headers, row, strict=True)}
    assert shown["N / ppm"] == f"{estimate['value']:.0f} ± 20"
    assert float(shown["N / µA"]) == pytest.approx(estimate["value"] * 1e-6 * 0.299e6, abs=0.06)
    assert float(shown["N / deg/s"]) == pytest.approx(estimate["value"] * 1e-6 * 83.0, abs=6e-5)
    assert shown["rows"] == "14"
    accelerometer = [row for row in outline.rows if row[:2] == ["channel", "set / °C"]][1]
    assert "N / g" in accelerometer


def test_every_estimate_has_its_place(model: ReportModel, outline: Outline) -> None:
    quantities = {row["quantity"] for row in model.results["estimates"]}
    assert quantities == {
        *("dsf_n", "dsf_p", "dsf_asymmetry", "bias", "dsf_n_drift", "master_clock_error"),
        *(f"{quantity}_tc{order}" for quantity in ("dsf_n", "dsf_p", "bias") for order in range(3)),
    }
    text = " ".join(cell for row in outline.rows for cell in row)
    assert text.count("−400 ± 10") == 50
    assert ["10", "Scale-factor error P / ppm", "100.0 ± 2.0", "8.00 ± 0.16", "0.03000 ± 0.00060"] in outline.rows
    assert ["10", "Bias / nA", "100.0 ± 1.0", "8.000 ± 0.080", "0.03000 ± 0.00030"] in outline.rows
    heads = (["Scale-factor error N / ppm"], ["Scale-factor error P / ppm"], ["Bias / nA"])
    assert sum(1 for row in outline.rows if row[1:2] in heads and len(row) == 5) == 30
    drift = "channel 1, gyro, repeat 1"  # the set temperature of all is in the caption
    assert ["Scale-factor error N, change between repeats", drift, "0.3 ± 2.1", "ppm"] in outline.rows
    assert ["Master-clock error", "–", "1.500 ± 0.010", "ppm"] in outline.rows


def test_figures_name_their_axes(page: str) -> None:
    for label, count in (
        ("Scale-factor error / ppm", 20),  # against temperature and against current
        ("Asymmetry N − P / ppm", 10),
        ("Bias / nA", 10),
        ("Unit temperature / °C", 30),
        ("Residual / ppm", 10),
        ("Reference current / mA", 20),
        ("Temperature / °C", 2),
        ("Time from hour 0 / h", 2),
    ):
        assert page.count(f">{label}</text>") == count, label


def test_quality_counts_flags(model: ReportModel, outline: Outline) -> None:
    assert model.counts.by_flag == {"lost": 1, "retaken": 1}
    assert (model.counts.records, model.counts.flagged) == (765, 1)
    assert ["flag lost", "1"] in outline.rows
    assert ["frames lost", "2"] in outline.rows
    assert Quality.LOST.name == "LOST"


def test_provenance_names_everything(outline: Outline) -> None:
    assert ["SHA-256 of the plan", "ab" * 32] in outline.rows
    assert ["software.packages.numpy", "2.4"] in outline.rows
    assert ["calibrator", "FLUKE", "5720A"] in outline.rows


def test_standards_show_what_was_applied(small: ReportModel, plain: ReportModel) -> None:
    register = {"calibrator": {**small.standards["calibrator"], "corrections": [{"range_A": 2.2e-4, "gain": 1e-6}]}}
    parser = Outline()
    parser.feed(Report(replace(plain, standards=register, started_utc=small.started_utc)).html())
    row = next(row for row in parser.rows if row[0] == "calibrator")
    assert row[1:6] == ["5720A", "SIM-5720", "SIM-0001", "1999-11-01", "2000-11-01"]
    assert row[6:] == ["305", "range / A 0.00022, gain 1·10⁻⁶"]


def test_a_standard_that_was_overdue_says_so(small: ReportModel, plain: ReportModel) -> None:
    register = {"calibrator": {**small.standards["calibrator"], "due": "1999-12-25"}, "counter": {"due": "soon"}}
    parser = Outline()
    parser.feed(Report(replace(plain, standards=register, started_utc=small.started_utc)).html())
    assert next(row for row in parser.rows if row[:2] == ["calibrator", "5720A"])[6] == "overdue by 7 days"
    assert next(row for row in parser.rows if row[:1] == ["counter"] and "soon" in row)[6] == "–"


@pytest.mark.parametrize(("simulated", "marked"), [(True, True), (None, True), (False, False)])
def test_simulated_is_said_unless_provenance_denies_it(
    small: ReportModel, simulated: bool | None, marked: bool
) -> None:
    results = {**small.results, "provenance": {} if simulated is None else {"simulated": simulated}}
    text = Report(ReportModel(title="T", results=results)).html()
    assert (text.count(WATERMARK) >= 3) is marked
    assert (WATERMARK in text) is marked


@pytest.mark.parametrize(
    ("verdicts", "kind", "words"),
    [
        (["none", "none"], "none", "Not judged"),
        (["pass", "none"], "good", "1 pass"),
        (["pass", "fail"], "bad", "1 fail, 1 pass"),
        (["pass", "conditional_fail"], "bad", "1 conditional fail, 1 pass"),
        (["pass", "conditional_pass"], "warn", "1 conditional pass, 1 pass"),
    ],
)
def test_verdict(verdicts: list[str], kind: str, words: str) -> None:
    results = sample_results()
    results["estimates"] = results["estimates"][:2]
    for row, verdict in zip(results["estimates"], verdicts, strict=True):
        row["verdict"], row["limit"] = verdict, 100.0
    model = ReportModel(title="T", results=results)
    text = Report(model).html()
    assert f'class="verdict {kind}"' in text
    assert words in text
    assert sum(verdict_counts(model).values()) == sum(verdict != "none" for verdict in verdicts)


def test_what_comes_from_a_file_is_escaped(plain: ReportModel) -> None:
    nasty = replace(plain, title="<b>x</b>", notes=("<script>alert(1)</script>",))
    text = Report(nasty).html()
    assert "<script" not in text
    assert "&lt;b&gt;x&lt;/b&gt;" in text


def test_zero_current_has_no_residual_in_ppm(model: ReportModel) -> None:
    assert len(model.residuals) == 10 * 5 * 12
    assert all(one.current_A for one in model.residuals)


def contrast_on_white(colour: str) -> float:
    """Contrast ratio against white. Source: WCAG 2.2, relative luminance of sRGB."""
    channels = [int(colour[start : start + 2], 16) / 255 for start in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 1.05 / (0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2] + 0.05)


def test_colours_are_legible_on_white_and_never_alone() -> None:
    assert contrast_on_white("#767676") == pytest.approx(4.54, abs=0.01)
    assert min(contrast_on_white(colour) for colour in (*PALETTE, GREY, INK)) >= 3.0
    assert len(set(PALETTE)) == len(set(MARKERS)) == 5
