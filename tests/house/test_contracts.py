"""Each contract of the imports fails alone when it is violated: import-linter skips what overlaps without a word."""

from __future__ import annotations

from copy import deepcopy
from functools import cache

import grimp
import pytest
from importlinter.api import read_configuration
from importlinter.application.use_cases import _get_built_in_contract_types
from importlinter.domain.contract import Contract
from tree import TOP

CONFIGURATION = read_configuration(str(TOP / ".importlinter"))
CONTRACTS = {str(options["id"]): options for options in CONFIGURATION["contracts_options"]}
PLANTED = {
    "floors": ("bench.maths.allan", "bench.plan.compile"),
    "systems": ("bench.systems.north.solve", "bench.systems.gnc.rows"),
    "engine-names-no-system": ("bench.session.partial", "bench.systems.north.analysis"),
    "declarations-are-plain": ("bench.systems.north.declaration", "bench.plan.language.sequence"),
    "estimators": ("bench.systems.north.estimators.tilt", "bench.analysis.numbers"),
    "worlds": ("sim_instruments.worlds.north.world", "sim_instruments.worlds.gnc.world"),
    "simulated-bench": ("sim_instruments.worlds.common.world", "sim_instruments.bus.live"),
    "no-instruments-in-bench": ("bench.run.bench.opener", "instruments.hp_3458a"),
    "instruments-know-floor-0-and-frames": ("instruments.hp_3458a", "bench.maths.allan"),
    "real-without-simulated": ("instruments.hp_3458a", "sim_instruments.hp_3458a"),
    "yaml-in-one-loader": ("bench.plan.compile", "yaml"),
    "buses-in-one-opener": ("bench.run.links.port", "serial"),
    "a-run-does-not-die-of-a-fit": ("bench.run.watch.trend", "scipy"),
    "the-guard-needs-nothing-that-can-fail": ("bench.run.guard.decision", "bench.frame.batch"),
    "clusters-in-one-place": ("bench.commands.study.study", "distributed"),
}


@cache
def graph() -> grimp.ImportGraph:
    """Every import of the packages, built once; a test plants its violation in a copy."""
    roots = CONFIGURATION["session_options"]["root_packages"]
    return grimp.build_graph(*roots, include_external_packages=True, cache_dir=None)


def is_kept(name: str, planted: tuple[str, str] | None = None, room: str | None = None) -> bool:
    """Whether a contract, checked alone, holds; ``planted``: one more import, ``room``: one more package."""
    known: dict[str, type[Contract]] = dict(_get_built_in_contract_types())
    options = CONTRACTS[name]
    contract = known[options["type"]](options["name"], CONFIGURATION["session_options"], options)
    changed = deepcopy(graph())
    if planted is not None:
        assert set(planted) <= changed.modules
        changed.add_import(importer=planted[0], imported=planted[1], line_number=1, line_contents="planted")
    if room is not None:
        changed.add_module(room)
    return contract.check(changed, verbose=False).kept


def test_every_contract_has_its_violation() -> None:
    assert set(PLANTED) == set(CONTRACTS)


@pytest.mark.parametrize("name", sorted(CONTRACTS))
def test_a_planted_violation_breaks_the_contract(name: str) -> None:
    assert is_kept(name)
    assert not is_kept(name, PLANTED[name])


def test_a_room_that_no_floor_names_is_refused() -> None:
    assert not is_kept("floors", room="bench.newroom")
