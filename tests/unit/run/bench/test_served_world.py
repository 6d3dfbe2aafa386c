"""What a prompt sets on a simulated bench that another process serves: told there, and only there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bench.model.errors import InputError
from bench.run.bench.opener import OpenBench
from bench.run.bench.served_world import ask, told
from sim_instruments.served.control_socket import ControlSocket

HEARD: list[list[str]] = []


def answer(words: Sequence[str]) -> dict[str, Any]:
    HEARD.append(list(words))
    if words[1] != "unit":
        raise InputError("B-SIM-018", "nobody can do this", where="here", next_step="leave it")
    return {"lines": []}


@pytest.fixture
def control(tmp_path: Path) -> Iterator[Path]:
    HEARD.clear()
    socket = ControlSocket(tmp_path / "control.sock", answer)
    yield tmp_path / "control.sock"
    socket.close()


def bench_at(control: Path | None) -> OpenBench:
    station: Any = SimpleNamespace(file=SimpleNamespace(control=None if control is None else str(control)))
    return OpenBench(station, {}, {}, None, lambda: None)


def test_what_a_person_does_is_told_to_the_process_that_serves_the_bench(control: Path) -> None:
    bench_at(control).operate("unit", "GNC-05")
    bench_at(control).operate("unit", 5)
    assert HEARD == [["operate", "unit", "GNC-05"], ["operate", "unit", "5"]]


def test_on_a_real_bench_the_person_has_done_it(control: Path) -> None:
    bench_at(None).operate("unit", "GNC-05")
    assert HEARD == []


def test_its_error_is_the_run_s_error(control: Path) -> None:
    with pytest.raises(InputError, match="nobody can do this") as caught:
        bench_at(control).operate("chamber", "1")
    assert (caught.value.code, caught.value.where, caught.value.next_step) == ("B-SIM-018", "here", "leave it")
    assert "error" in ask(control, ["operate", "chamber", "1"])


def test_a_bench_that_is_gone_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="B-SIM-015"):
        told(tmp_path / "none.sock", ["operate", "unit", "GNC-05"])
