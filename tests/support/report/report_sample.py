"""A synthetic campaign for the tests of the report: ten channels, five temperatures, seeded numbers, no physics."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.axis import Axis, Tick
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray
from plan_sample import planned

from bench.analysis import Analysis, build_results, estimate, with_uncertainty
from bench.model.quantities import Quality
from bench.plan import Step
from bench.report import RunStory, Surrounding, TemperatureTrace, report_model
from bench.report.model import ReportModel
from bench.report.plots.style import drawing
from bench.report.sheet import ROOM_pt
from bench.session.fitted import Shown

TEMPERATURES_degC = (-10.0, 5.0, 20.0, 35.0, 50.0)
LEVELS_A = {"gyro": (3e-5, 1e-4, 1e-3, 1e-2, 0.1, 0.2), "accelerometer": (5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)}
_SLOT_s, _POINT_s = 9000.0, 120.0


@dataclass(frozen=True)
class SamplePlan:
    title: str
    steps: tuple[Step, ...]
    prepare_s: float


def kind_of(channel: int) -> str:
    return "gyro" if channel <= 6 else "accelerometer"


def sample_steps(temperatures: tuple[float, ...] = TEMPERATURES_degC) -> tuple[Step, ...]:
    steps = [planned("prompt", phase="prepare"), planned("settle", phase="prepare", duration_s=600.0)]
    now_s = 0.0
    for index, temperature in enumerate(temperatures):
        told = {"temperature": temperature, "ramp": 0.5, "conditions": {"temperature_degC": temperature}}
        steps.append(planned("soak", at_s=now_s, duration_s=_SLOT_s, **told))
        now_s += _SLOT_s
        rounds = [(channel, 0) for channel in range(1, 11)]
        rounds += [(1, 1)] if index == len(temperatures) - 1 else []
        for channel, repeat in rounds:
            for _ in range(15):
                conditions = {"channel": channel, "repeat": repeat}
                steps.append(planned("settle", at_s=now_s, duration_s=20.0, conditions={"channel": channel}))
                steps.append(planned("record", at_s=now_s + 20.0, duration_s=100.0, conditions=conditions))
                now_s += _POINT_s
    steps.append(planned("settle", phase="finally", duration_s=60.0))
    return tuple(steps)


def estimate_entry(quantity: str, unit: str, value: float, expanded: float, **conditions: Any) -> dict[str, Any]:
    found = {"quantity": quantity, "unit": unit, "value": value, "conditions": conditions, "n": 14, "dropped": 0}
    stated = {"std_uncertainty": expanded / 1.96, "coverage_factor": 1.96, "expanded_uncertainty": expanded}
    return {**found, **stated, "limit": None, "verdict": "none"}


def unsound(entry: dict[str, Any], quality: str = "doubtful") -> dict[str, Any]:
    """Return an entry as a check leaves it that speaks against it."""
    numbers = "std_uncertainty", "coverage_factor", "expanded_uncertainty", *["value"] * (quality == "refused")
    reason = {"code": "odd", "sentence": "It is odd.", "figure": None}
    return {**entry, **dict.fromkeys(numbers), "quality": quality, "reasons": [reason], "verdict": "indeterminate"}


def sample_estimates(rng: np.random.Generator) -> list[dict[str, Any]]:
    rows = []
    for channel in range(1, 11):
        base = {"channel": channel, "kind": kind_of(channel)}
        n, p = rng.normal(0.0, 400.0, 2)
        for t in TEMPERATURES_degC:
            where = {**base, "temperature_degC": t, "unit_temperature_degC": t + 0.4}
            rows.append(estimate_entry("dsf_n", "ppm", n + 8.0 * (t - 20), 19.9, **where))
            rows.append(estimate_entry("dsf_p", "ppm", p + 7.0 * (t - 20), 19.9, **where))
            rows.append(estimate_entry("dsf_asymmetry", "ppm", n - p + (t - 20), 0.2, **where))
            rows.append(estimate_entry("bias", "A", -4e-7, 1e-8, **where))
        reference = {**base, "reference_temperature_degC": 20.0}
        for order, unit, value in (("tc0", "", 100.0), ("tc1", "/degC", 8.0), ("tc2", "/degC2", 0.03)):
            rows += [
                estimate_entry(f"{q}_{order}", f"ppm{unit}", value, value / 50, **reference) for q in ("dsf_n", "dsf_p")
            ]
            rows.append(estimate_entry(f"bias_{order}", f"A{unit}", value * 1e-9, value * 1e-11, **reference))
    drift = {"channel": 1, "kind": "gyro", "temperature_degC": 50.0, "repeat": 1}
    rows.append(estimate_entry("dsf_n_drift", "ppm", 0.3, 2.1, **drift))
    rows.append(estimate_entry("master_clock_error", "ppm", 1.5, 0.01, temperature_degC=50.0))
    return rows


def sample_results(simulated: bool = True) -> dict[str, Any]:
    hashes = {"plan_sha256": "ab" * 32, "frame_sha256": "cd" * 32, "session_sha256": "ef" * 32}
    frames = {"frames": 15_048_000, "frames_bad": 3, "frames_lost": 2}
    return {
        "schema": 1,
        "session": "20000101T000000Z_scale_factor_38h_SIM-1",
        "campaign": "scale_factor",
        "uut": {"model": "NGU", "serial": "SIM-1"},
        "estimates": sample_estimates(np.random.default_rng(7)),
        "quality": {"records": 765, **frames, "splices": 0, "retaken": 1},
        "provenance": {"simulated": simulated, **hashes, "software": "inertial-bench 0.1.0"},
    }


def sample_residuals(rng: np.random.Generator) -> list[dict[str, Any]]:
    rows = []
    for channel in range(1, 11):
        floor_A = 5e-9 if channel <= 6 else 4e-10
        for t in TEMPERATURES_degC:
            for level in LEVELS_A[kind_of(channel)]:
                for sign in (1, -1):
                    residual = rng.normal(0.0, floor_A + 1e-6 * level)
                    where = {"channel": channel, "kind": kind_of(channel), "temperature_degC": t}
                    rows.append({**where, "current_A": sign * level, "residual_A": residual})
            rows.append({"channel": channel, "temperature_degC": t, "current_A": 0.0, "residual_A": floor_A})
    return rows


def sample_trace() -> TemperatureTrace:
    t_s = np.arange(0.0, 136_800.0, 10.0)
    corners = np.array([0, 3960, 27000, 28800, 54000, 55800, 81000, 82800, 108000, 109800, 136800])
    air = np.interp(t_s, corners, [23, -10, -10, 5, 5, 20, 20, 35, 35, 50, 50])
    unit = air.copy()
    for index in range(1, unit.size):
        unit[index] = unit[index - 1] + (air[index] - unit[index - 1]) * 10 / 1500
    return TemperatureTrace(t_s, air, unit)


def sample_room() -> Surrounding:
    t_s = np.arange(0.0, 136_800.0, 1500.0)
    return Surrounding("logger 101", t_s, 23.0 + 0.2 * np.sin(t_s / 2e4), laboratory=True)


def sample_manifest() -> dict[str, Any]:
    kinds = {"gyro": (0.299, 83.0, "deg/s"), "accelerometer": (0.0242, 20.2, "g")}
    keys = ("full_scale_A", "sensor_full_scale", "sensor_unit")
    channels = [
        {"number": number, "kind": kind_of(number), **dict(zip(keys, kinds[kind_of(number)], strict=True))}
        for number in range(1, 11)
    ]
    certificate = {"certificate": "SIM-0001", "calibrated": "1999-11-01", "due": "2000-11-01"}
    corrections = [{"range_A": 2.2e-4, "gain": 0.0, "offset_A": 0.0}]
    standard = {"driver": "fluke_5720a", "model": "5720A", "serial": "SIM-5720", **certificate}
    standard |= {"corrections": corrections}
    return {
        "title": "AF-converter scale factor, 5 temperatures x 10 channels x 15 steps",
        "campaign": {"reference_temperature_degC": 20.0, "channels": channels},
        "standards": {"calibrator": standard, "counter": {**standard, "model": "53230A", "corrections": []}},
        "software": {"python": "3.11", "packages": {"numpy": "2.4"}},
        "identities": {"calibrator": {"manufacturer": "FLUKE", "model": "5720A"}},
    }


def sample_model(simulated: bool = True) -> ReportModel:
    window = SimpleNamespace(conditions={"channel": 1})
    rows = [SimpleNamespace(window=window, frames=10_000, lost=0, bad=0, quality=Quality.GOOD)] * 764
    flags = Quality.LOST | Quality.RETAKEN
    rows.append(SimpleNamespace(window=window, frames=9_990, lost=10, bad=2, quality=flags))
    residuals = sample_residuals(np.random.default_rng(8))
    return replace(
        report_model(sample_results(simulated), rows, sample_steps(), sample_manifest(), 600.0, residuals),
        trace=sample_trace(),
        components=(
            {"kind": "gyro", "component": "calibrator gain", "distribution": "normal", "std_uncertainty_ppm": 10.0},
            {"kind": "gyro", "component": "quantisation", "distribution": "triangular", "std_uncertainty_ppm": 1.84},
        ),
        prompts=({"step": 0, "text": "Calibrator output floating?", "confirm": "operator", "by": "simulation"},),
        notes=("The bias of this campaign is diagnostic; it enters no coefficient.",),
        run=sample_story(),
    )


def sample_story() -> RunStory:
    return RunStory(
        commands=({"time": "1:00:00", "what": "pause", "by": "A. Person, operator", "reason": "lunch"},),
        alarms=({"time": "2:00:00", "what": "interlock", "text": "lab_air warned: 24.3 degC, limit 24 degC"},),
        surroundings=(sample_room(),),
        length_s=140_657.0,
        hashes={"sequences/scale_factor_38h.yaml": "12" * 32},
    )


def small_model() -> ReportModel:
    """The same with one channel and no residuals: for tests of what is not drawn."""
    model = sample_model()
    rows = [row for row in model.results["estimates"] if row["conditions"].get("channel", 1) == 1]
    return replace(model, results={**model.results, "estimates": rows}, residuals=())


POINTS_PER_INCH, LEAST_pt = 72.0, 6.5
TOUCH_px = 0.5  # texts may come as near as this fraction of a pixel at 100 dots per inch


@dataclass(frozen=True)
class Box:
    text: str
    corners: NDArray[np.float64]  # (4, 2), pixel

    def meets(self, other: "Box") -> bool:
        """Separating axes: two convex shapes are apart if the normal of one side tells them apart."""
        for shape in (self.corners, other.corners):
            for side in np.diff(np.vstack((shape, shape[:1])), axis=0):
                normal = np.array((-side[1], side[0])) / (np.hypot(*side) or 1.0)
                a, b = self.corners @ normal, other.corners @ normal
                if a.max() <= b.min() + TOUCH_px or b.max() <= a.min() + TOUCH_px:
                    return False
        return True


def recorded_figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Every figure that is saved from now on, in order."""
    found: list[Figure] = []
    plain = Figure.savefig

    def savefig(self: Figure, *words: object, **options: object) -> None:
        found.append(self)
        plain(self, *words, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    return found


def text_boxes(figure: Figure) -> list[Box]:
    """Boxes of all texts that the figure draws, at 100 dots per inch."""
    with drawing():
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(100)
        figure.draw_without_rendering()  # lays everything out; nobody looks at the pixels
        return [_box(text, canvas) for text in _drawn(figure)]


def _drawn(figure: Figure) -> Iterator[Text]:
    ticks = {id(text) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for text in _all_labels(axis)}
    shown = {id(text) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for text in _in_view(axis)}
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and (id(text) not in ticks or id(text) in shown):
            yield text


def _all_labels(axis: Axis) -> list[Text]:
    return [label for tick in _ticks(axis) for label in (tick.label1, tick.label2)]


def _ticks(axis: Axis) -> list[Tick]:
    return [*axis.get_major_ticks(), *axis.get_minor_ticks()]


def _in_view(axis: Axis) -> list[Text]:
    """Labels of the ticks between the ends of an axis; matplotlib keeps others and does not draw them."""
    low, high = sorted(axis.get_view_interval())
    reach = 1e-6 * (high - low)
    labels = [tick.label1 for tick in _ticks(axis) if low - reach <= tick.get_loc() <= high + reach]
    return [label for label in labels if label.get_visible()]


def _box(text: Text, canvas: FigureCanvasAgg) -> Box:
    renderer = canvas.get_renderer()
    seen = text.get_window_extent(renderer)  # of a turned text: the box around it, which has the same middle
    turned = text.get_rotation()
    text.set_rotation(0.0)
    flat = text.get_window_extent(renderer)
    text.set_rotation(turned)
    half = np.array((flat.width, flat.height)) / 2.0
    signs = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1)))
    angle = np.radians(turned)
    turn = np.array(((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))))
    middle = np.array(((seen.x0 + seen.x1) / 2.0, (seen.y0 + seen.y1) / 2.0))
    return Box(text.get_text(), middle + (signs * half) @ turn)


def collisions(boxes: list[Box]) -> list[tuple[str, str]]:
    """Pairs of texts that overlap."""
    ends = [(*box.corners.min(axis=0).tolist(), *box.corners.max(axis=0).tolist()) for box in boxes]
    return [
        (boxes[a].text, boxes[b].text)
        for a, b in combinations(range(len(boxes)), 2)
        if ends[a][0] < ends[b][2]
        and ends[b][0] < ends[a][2]
        and ends[a][1] < ends[b][3]
        and ends[b][1] < ends[a][3]
        and boxes[a].meets(boxes[b])
    ]


def outside(figure: Figure, boxes: list[Box]) -> list[str]:
    """Texts that reach beyond the edge of their figure."""
    width, height = figure.bbox.size
    return [
        box.text
        for box in boxes
        if box.corners.min() < -TOUCH_px
        or box.corners[:, 0].max() > width + TOUCH_px
        or box.corners[:, 1].max() > height + TOUCH_px
    ]


def flaws(figure: Figure) -> list[str]:
    """What an eye would object to on A4: collisions, cut texts, axes without a unit, type that is too small."""
    boxes = text_boxes(figure)
    found = [f"{one!r} on {other!r}" for one, other in collisions(boxes)]
    found += [f"{text!r} is cut off" for text in outside(figure, boxes)]
    numbered = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) if _numbered(axis)]
    found += [f"no unit in {text!r}" for axis in numbered if " / " not in (text := axis.get_label_text())]
    printed = ROOM_pt / POINTS_PER_INCH / figure.get_figwidth()
    least_pt = min(text.get_fontsize() for text in _drawn(figure)) * printed
    return found + ([f"type of {least_pt:.2f} pt"] if least_pt < LEAST_pt else [])


def _numbered(axis: Axis) -> bool:
    """False for an axis of names, or one whose numbers its neighbour shows."""
    words = [text.get_text() for text in _in_view(axis)]
    return any(words) and not any(word[:1].isalpha() for word in words if not word.startswith("$"))


_UNITS = (1.0, 1e2, 1e3, 1e6, 3600.0, 3.6e6, math.sqrt(0.5), 6400.0 / 360.0)  # that tables use beside results.json
_CODE_NAME = re.compile(r"(?<![\w/.])[a-z][a-z0-9]*(?:_[a-z0-9]+)+(?![\w/.])")


def code_names(page: str) -> set[str]:
    """Return words with underscores that a reader sees, but for what names files: the sequence, software and hashes."""
    seen = re.sub(r"<(style|section id=\"provenance\").*?</(style|section)>", "", page, flags=re.DOTALL)
    return set(_CODE_NAME.findall(re.sub(r"<[^>]*>|Sequence \w+,", " ", seen)))


def intervals_of_tables_alone(shown: Shown) -> set[str]:
    """Return what tables of an analysis state as value ± U that is no estimate with its expanded uncertainty."""
    stated = {
        with_uncertainty(unit * entry["value"], unit * entry["expanded_uncertainty"])
        for entry in shown.results["estimates"]
        if entry["expanded_uncertainty"]
        for unit in _UNITS
    }
    cells = {cell for table in shown.analysis.tables for row in table.rows for cell in row if "±" in str(cell)}
    return {cell.replace("-", "−").removesuffix(" WORSE") for cell in cells} - stated


SEED = 5
LIMIT = 1e-3


def provenance(simulated: bool = True) -> dict[str, Any]:
    hashes = dict.fromkeys(("plan_sha256", "frame_sha256", "session_sha256"), "0" * 64)
    return {"simulated": simulated, **hashes, "software": "test 0"}


def results(
    session: str, serial: str, estimates: list[dict[str, Any]], *, simulated: bool = True, incomplete: bool = False,
    campaign: str = "imu_calibration",
) -> dict[str, Any]:  # fmt: skip
    """The document results.json of a session."""
    analysis = Analysis(campaign, "ls", {"model": "GNC", "serial": serial}, estimates)
    return build_results(session, analysis, {}, provenance(simulated), {"rule": "simple"}, incomplete=incomplete)


def coupling(value: float, axis: str = "x", unit: str = "", u: float = 2e-5) -> dict[str, Any]:
    """A judged estimate of one axis; ``unit``: whose it is in a session of several."""
    where = {"kind": "gyro", "row": "x", "column": axis, **({"unit": unit} if unit else {})}
    return estimate("gyro_cross_coupling", "1", value, u, where, n=6, limit=LIMIT)


def calibrated(serial: str, rng: np.random.Generator) -> dict[str, Any]:
    """A calibration of one unit: couplings, scale errors, a matrix without limits, and a count that must be zero."""
    found = []
    for axis in "xyz":
        where = {"kind": "gyro", "axis": axis}
        found.append(coupling(float(rng.normal(0.0, 2.6e-4)), axis))
        found.append(estimate("gyro_scale_error", "ppm", float(rng.normal(0, 4000)), 9.0, where, n=6))
        stability = float(rng.normal(5.9, 0.3))
        found.append(estimate("gyro_bias_stability", "deg/h", stability, 0.2, where, n=360, limit=10.0))
        for column in "xyz":
            value = float(rng.normal(float(axis == column), 2e-4))
            found.append(estimate("gyro_matrix", "1", value, 1e-5, {"row": axis, "column": column}, n=6))
    found.append(estimate("memory_wrong", "1", float(rng.random() < 0.02), 0.0, {"item": "memory"}, n=14, limit=0.0))
    return results(f"20000101T000000Z_gnc_imu_calibration_{serial}", serial, found)


def calibrations(count: int) -> list[dict[str, Any]]:
    """Calibrations of ``count`` units."""
    rng = np.random.default_rng(SEED)
    return [calibrated(f"GNC-{number:03d}", rng) for number in range(1, count + 1)]
