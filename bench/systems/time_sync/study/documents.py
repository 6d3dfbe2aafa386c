"""Figures and tables of the study as plain documents, in the form that the report draws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Document = dict[str, Any]
Documents = list[Document]


def curve(label: str, x: Any, y: Any, style: str = "line") -> Document:
    """One series of a figure."""
    return {"label": label, "x": np.asarray(x).tolist(), "y": np.asarray(y).tolist(), "style": style}


def scattered(label: str, x: Any, y: Any, std: Any) -> Document:
    """Points with their scatter, one standard deviation either way."""
    y, std = np.asarray(y), np.asarray(std)
    return {**curve(label, x, y, "points"), "low": (y - std).tolist(), "high": (y + std).tolist()}


def picture(x: Any, y: Any, z: Any) -> Document:
    """An image over the span of its axes: ``z`` (y, x)."""
    spans = {"x": [float(x[0]), float(x[-1])], "y": [float(y[0]), float(y[-1])]}
    return {"label": "", "style": "image", **spans, "z": np.asarray(z).tolist()}


def drawn(title: str, caption: str, labels: tuple[str, str], parts: Documents, group: str, **more: Any) -> Document:
    """A figure with its axes; ``labels`` of x and y."""
    axes = {"x_label": labels[0], "y_label": labels[1]}
    return {"title": title, "caption": caption, **axes, "series": parts, "group": group, **more}


def table(title: str, caption: str, headers: Sequence[str], rows: Sequence[Sequence[Any]], **more: Any) -> Document:
    """A table with its caption."""
    return {"title": title, "caption": caption, "headers": list(headers), "rows": [list(row) for row in rows], **more}


def milliseconds(offset_ms: float) -> str:
    """An offset as a label."""
    return f"{offset_ms:g} ms"
