"""Pictures of the spread of a batch: for each quantity a strip of bars per condition, and the limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from bench.analysis import limits_text, number, unit_text
from bench.model.systems import is_size
from bench.model.texts import Texts, quantity_title
from bench.report.batch.model import Batch, Spread
from bench.report.estimate_tables import prefixed
from bench.report.model import Picture
from bench.report.plots.style import BLUE, GREY, INK, VERMILION, drawing, inline_svg, panels_of
from bench.report.tables import label

MOST_PANELS = 24  # of a campaign; judged quantities come first
_PER_PICTURE = 8
_MOST_STRIPS = 9
_LONGEST = 14  # characters of a strip's label
_LONGEST_TITLE = 44
_BINS = 24
_FEW = 30  # values whose dashes can be told apart
_FAR = 20.0  # means this many times farther apart than the widest strip is wide: each strip about its own mean
_LIMIT_IN_SIGHT = 4.0  # limits within this many times the greatest value are drawn
Strips = Sequence[tuple[str, NDArray[np.float64], NDArray[np.bool_]]]


def strip_pictures(batch: Batch, words: Texts) -> list[Picture]:
    """Return pictures of at most ``_PER_PICTURE`` quantities; of a quantity of one value nothing is drawn."""
    pictures: list[Picture] = []
    for campaign in batch.campaigns:
        groups = [group for group in _by_name(batch, campaign) if sum(len(spread.members) for spread in group) > 1]
        groups = sorted(groups, key=lambda group: group[0].worst is None)[:MOST_PANELS]
        for at in range(0, len(groups), _PER_PICTURE):
            shown, name = groups[at : at + _PER_PICTURE], f"strips{len(pictures) + 1}"
            titles = ", ".join(_title(group, words) for group in shown)
            told = words("batch.strips_of", campaign=campaign.replace("_", " "), quantities=titles)
            pictures.append(Picture(name, _drawn(shown, name, words), words("batch.strips"), told))
    return pictures


def _title(group: Sequence[Spread], words: Texts) -> str:
    """Return the name of a quantity; one that would run into the next panel stays as in results.json."""
    quantity = group[0].quantity
    title = quantity_title(quantity.campaign, quantity.name, words.language)
    return title if len(title) <= _LONGEST_TITLE else quantity.name


def _by_name(batch: Batch, campaign: str) -> list[list[Spread]]:
    spreads = [spread for spread in batch.spreads if spread.quantity.campaign == campaign]
    ordered = sorted(spreads, key=lambda spread: (spread.quantity.name, spread.quantity.unit))
    return [
        list(group) for _, group in groupby(ordered, key=lambda spread: (spread.quantity.name, spread.quantity.unit))
    ]


def _drawn(groups: Sequence[Sequence[Spread]], name: str, words: Texts) -> str:
    with drawing():
        figure, panels = panels_of([_title(group, words) for group in groups], legend_rows=0)
        for axes, group in zip(panels, groups, strict=True):
            _draw(axes, group, words)
        return inline_svg(figure, name)


def _draw(axes: Axes, group: Sequence[Spread], words: Texts) -> None:
    members = [member for spread in group for member in spread.members]
    scale, unit = prefixed(group[0].quantity.unit, [member.value for member in members])
    strips = _strips(group, scale, words)
    stated = {spread.limits for spread in group}
    limits = next(iter(stated)) if len(stated) == 1 else None
    about_means = limits is None and _far_apart(strips)
    if about_means:
        strips = [(text, values - values.mean(), failed) for text, values, failed in strips]
    edges = _edges([values for _, values, _ in strips])
    for place, (_, values, failed) in enumerate(reversed(strips)):
        _strip(axes, place, values, failed, edges)
    axes.set_yticks([place + 0.35 for place in range(len(strips))], [text for text, _, _ in reversed(strips)])
    axes.set_ylim(-0.1, len(strips))
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.locator_params(axis="x", nbins=5)
    size = is_size(group[0].quantity.campaign, group[0].quantity.name)
    drawn = () if limits is None else limits[size:]  # of a size the upper one alone
    _limits(axes, [scale * limit for limit in drawn], members_reach=float(np.abs(edges).max()))
    axes.set_xlabel(_axis_text(unit, limits_text(limits, scale, size=size) if limits else "", about_means, words))


def _strips(group: Sequence[Spread], scale: float, words: Texts) -> Strips:
    """Return label, values and which of them failed, for each condition; all in one strip where there are too many."""
    strips = []
    shared = {name for name in group[0].quantity.where if len({_text(spread, name) for spread in group}) == 1}
    for spread in group:
        label_text = " ".join(_text(spread, name) for name in spread.quantity.where if name not in shared)
        values = np.array([scale * member.value for member in spread.members])
        strips.append((label_text, values, np.array([member.failed for member in spread.members])))
    if len(strips) <= _MOST_STRIPS and all(len(text) <= _LONGEST for text, _, _ in strips):
        return strips
    everything = (np.concatenate([strip[1] for strip in strips]), np.concatenate([strip[2] for strip in strips]))
    return [(words("batch.together", count=len(strips)), *everything)]


def _text(spread: Spread, name: str) -> str:
    where: Mapping[str, Any] = spread.quantity.where
    value = where.get(name, "")
    return number(value) if isinstance(value, float) else str(value)


def _far_apart(strips: Strips) -> bool:
    means = [float(values.mean()) for _, values, _ in strips]
    return max(means) - min(means) > _FAR * max(float(np.ptp(values)) for _, values, _ in strips)


def _edges(values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    low, high = min(strip.min() for strip in values), max(strip.max() for strip in values)
    room = 0.02 * (high - low) or max(abs(high) * 1e-3, 1e-12)
    return np.linspace(low - room, high + room, _BINS + 1)


def _strip(
    axes: Axes, place: int, values: NDArray[np.float64], failed: NDArray[np.bool_], edges: NDArray[np.float64]
) -> None:
    counts, _ = np.histogram(values, edges)
    middles, width = (edges[:-1] + edges[1:]) / 2.0, float(edges[1] - edges[0])
    alpha = 0.9 if len(values) <= _FEW else 0.25
    axes.axhline(place, color=GREY, linewidth=0.5)
    axes.bar(middles, 0.8 * counts / counts.max(), width=width, bottom=place, color=BLUE, alpha=0.55, linewidth=0.0)
    axes.plot(
        values, np.full(len(values), place + 0.05), linestyle="none", marker="|", markersize=3.5, color=INK, alpha=alpha
    )
    if failed.any():
        axes.plot(values[failed], np.full(failed.sum(), place + 0.3), linestyle="none", marker="^", color=VERMILION)


def _limits(axes: Axes, limits: Sequence[float], members_reach: float) -> None:
    if all(math.isinf(limit) or abs(limit) <= _LIMIT_IN_SIGHT * members_reach for limit in limits):
        for limit in sorted({limit for limit in limits if math.isfinite(limit)}):
            axes.axvline(limit, color=VERMILION, linewidth=1.0)


def _axis_text(unit: str, limits: str, about_means: bool, words: Texts) -> str:
    text = label(unit_text(unit)) if unit != "1" else ""
    if limits:
        return words("batch.axis_limits", unit=text, limit=limits).strip()
    return words("batch.axis_deviation", unit=text).strip() if about_means else text
