"""A campaign of GNC modules that is killed and gone on with: every result is there once and says what it would."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from rehearsal import SEED, Crashes, Watched, crashed_at, go_on, nobody, watch_worlds

from bench.model.clock import VirtualClock
from bench.plan import PlannedCommand, Step, compile_sequence
from bench.record import SessionReader
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from bench.session.service import read_view
from bench.session.view import analyse_view
from sim_instruments.worlds.common.world import World

UNITS = ("GNC-01", "GNC-02")
PLACES = {  # kind, name and which of these steps is about to begin when the run is killed
    "static check": ("prompt", "", 19),  # of the second unit
    "supply": ("call", "measure_current", 2),
    "timer": ("unit", "timer", 3),
    "erase": ("unit", "memory", 7),
    "verify": ("unit", "memory", 10),
    "dip switch": ("unit", "ad", 3),
    "io": ("unit", "io", 35),
    "spi": ("unit", "spi", 1),
}


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Crashes:
    """One run of two units, copied at every place, undisturbed to its end."""
    folder = tmp_path_factory.mktemp("units")
    plan = compile_sequence("gnc_unit_test", None, {"units": ",".join(UNITS)})
    return crashed_at(plan, folder, {step_of(plan.steps, *place) for place in PLACES.values()})


def step_of(steps: Any, kind: str, name: str, count: int) -> int:
    found = [step.number for step in steps if (step.kind, step.name if name else "") == (kind, name)]
    return int(found[count - 1])


def results_of(folder: Path) -> dict[str, dict[str, Any]]:
    results, _ = analyse_view(read_view(folder))
    names = [f"{one['quantity']} {json.dumps(one['conditions'], sort_keys=True)}" for one in results["estimates"]]
    assert len(set(names)) == len(names)
    return dict(zip(names, results["estimates"], strict=True))


@pytest.mark.parametrize("place", PLACES)
def test_killed_units_are_tested_to_the_end(
    killed: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    source = killed.at(step_of(killed.plan.steps, *PLACES[place]))
    folder = Path(shutil.copytree(source, tmp_path / source.name))
    watch_worlds(monkeypatch, watched := nobody())
    run = go_on(folder, watched)
    assert run.outcome.error is None
    assert run.outcome.unsafe == ()
    whole, found = results_of(killed.whole), results_of(folder)
    assert found.keys() == whole.keys()
    assert {name: one.get("verdict") for name, one in found.items()} == {
        name: one.get("verdict") for name, one in whole.items()
    }
    tests = [step.number for step in killed.plan.steps if isinstance(step, PlannedCommand) and step.item]
    noted = [fields["step"] for _, _, fields in SessionReader(folder).events("exchange")]
    assert sorted(set(noted)) == tests
    answered = {fields["step"] for _, _, fields in SessionReader(folder).events("prompt")}
    assert answered == {step.number for step in killed.plan.steps if step.kind == "prompt"}
    assert not watched.worlds[-1].instruments["supply"].on


def test_the_board_is_not_powered_while_a_unit_is_changed(
    killed: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the way back to the static checks of the second unit its supply stays off."""
    source = killed.at(step_of(killed.plan.steps, *PLACES["static check"]))
    folder = Path(shutil.copytree(source, tmp_path / source.name))
    asked: list[bool] = []

    def look(world: World, step: Step) -> None:
        asked.append(world.instruments["supply"].on)

    watched = Watched(look)
    watch_worlds(monkeypatch, watched)
    go_on(folder, watched)
    first = next(at for at, step in enumerate(watched.steps) if step.name == "output_on")
    assert not any(asked[: first + 1])
    sent = [fields for fields in _traffic(folder, "supply") if fields.startswith("OUTP ON")]
    assert len(sent) == len(UNITS)


def _traffic(folder: Path, role: str) -> list[str]:
    messages = (one for one in SessionReader(folder).messages() if one.topic.endswith(f"/{role}"))
    return [str(one.document()["text"]) for one in messages if one.document()["direction"] == "tx"]


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("gnc_unit_test", {"units": "GNC-01"}),
        ("gnc_magnetometer", {"warm_up": "1 s", "record_time": "5 s", "attitude_time": "4 s"}),
    ],
)
def test_same_seed_same_bytes(tmp_path: Path, name: str, settings: dict[str, str]) -> None:
    plan = compile_sequence(name, None, settings)
    found = []
    for number in range(2):
        run = conduct(
            plan, clock=VirtualClock(), seed=SEED, out=tmp_path / str(number), operator=SimulatedOperator(),
            listener=Watched(lambda world, step: None, worlds=[None]),  # type: ignore[list-item]
        )  # fmt: skip
        assert run.outcome.error is None
        found.append((run.folder / "session.0001.mcap").read_bytes())
    assert found[0] == found[1]
