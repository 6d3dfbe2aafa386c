"""A simulated bench served by a process of its own, once for all tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from served import Served

TESTS = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def bench_in_real_time(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = Served(tmp_path_factory.mktemp("served"))
    try:
        yield served
    finally:
        served.close()


@pytest.fixture
def served(bench_in_real_time: Served) -> Iterator[Served]:
    """The bench without faults, at rest."""
    bench_in_real_time.fault("clear")
    yield bench_in_real_time
    bench_in_real_time.fault("clear")


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"
