"""Figure of what uncertainty costs: hours of the shortest campaign against the targets it reaches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from bench.report.plots.style import BLUE, INK, drawing, svg_text


def plot_trade(name: str, points: Sequence[tuple[float, float]], today_h: float, path_svg: Path) -> None:
    """Write hours against the factor on all targets, (n, 2), as an SVG file; a line marks the given campaign."""
    with drawing():
        figure = Figure(figsize=(5.6, 3.4), layout="constrained")
        axes = figure.subplots()
        axes.axhline(today_h, color=INK, linewidth=0.9, linestyle="--", label=f"{name}, as given")
        axes.plot(*zip(*points, strict=True), color=BLUE, marker="o", label="shortest plan under the rules")
        axes.set_xscale("log")
        axes.set_xticks([factor for factor, _ in points])
        axes.get_xaxis().set_major_formatter(ScalarFormatter())
        axes.get_xaxis().set_minor_formatter(lambda *_: "")
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("expanded uncertainty over that of the targets")
        axes.set_ylabel("campaign in h")
        axes.legend()
        path_svg.write_text(svg_text(figure, "trade"), encoding="utf-8")
