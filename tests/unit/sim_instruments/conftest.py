"""A simulated bench in virtual time, and one served in real time."""

from collections.abc import Iterator

import pytest
from sim_bench import Bench, Served, open_bench, serve


@pytest.fixture
def bench() -> Iterator[Bench]:
    with open_bench() as opened:
        yield opened


@pytest.fixture
def served() -> Iterator[Served]:
    with serve() as opened:
        yield opened
