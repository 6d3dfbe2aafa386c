"""The extras: packages that recording and judging do without, and what each of them gives."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NamedTuple

from bench.model.errors import BenchError, InputError


class Extra(NamedTuple):
    """An extra of the distribution; ``gives``: what is missing without it."""

    name: str
    gives: str


REPORT = Extra("report", "drawing a report or a figure")
PAGE = Extra("page", "the live page")
TERMINAL = Extra("terminal", "the terminal view")
HISTORY = Extra("history", "the calibration history")
ARCHIVE = Extra("archive", "the archive of sessions")
MQTT = Extra("mqtt", "telling a broker of MQTT")
EXTRAS = {
    "matplotlib": REPORT,
    "jinja2": REPORT,
    "starlette": PAGE,
    "uvicorn": PAGE,
    "httptools": PAGE,
    "websockets": PAGE,
    "itsdangerous": PAGE,
    "bokeh": PAGE,
    "prometheus_client": PAGE,
    "paho": MQTT,
    "textual": TERMINAL,
    "sqlalchemy": HISTORY,
    "fsspec": ARCHIVE,
}


def missing_extra(error: ModuleNotFoundError) -> InputError:
    """Return the one line about a package that is not installed, B-PKG-005, with the extra that brings it.

    Raises: ``error`` itself if its module belongs to none of these extras.
    """
    package = (error.name or "").partition(".")[0]
    if package not in EXTRAS:
        raise error
    extra = EXTRAS[package]
    return InputError(
        "B-PKG-005",
        f"{extra.gives} needs {package}, which is not installed",
        next_step=f"pip install 'inertial-bench[{extra.name}]'",
    )


def optional(name: str, missing: BenchError) -> Any:
    """Return a module that may not be installed. Raises: ``missing`` if its package is not."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in (name, name.partition(".")[0]):
            raise
        raise missing from error


@contextmanager
def extras_named() -> Iterator[None]:
    """Turn a package that is missing into its one line. Raises: InputError B-PKG-005."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise missing_extra(error) from error
