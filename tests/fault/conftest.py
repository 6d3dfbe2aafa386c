"""A simulated bench served by a process of its own, once for the tests of a file: idle it costs too."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from served import Served, serving


@pytest.fixture(scope="module")
def bench_in_real_time(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with serving(tmp_path_factory.mktemp("served")) as served:
        yield served


@pytest.fixture
def served(bench_in_real_time: Served) -> Iterator[Served]:
    """The bench without faults, at rest."""
    bench_in_real_time.fault("clear")
    yield bench_in_real_time
    bench_in_real_time.fault("clear")


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"
