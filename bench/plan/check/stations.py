"""Static check of a station: addresses, links, drivers and options, the simulated world, the register of standards.

The interlocks of a plan are those of its station, and those of its sequence, which win where the names are equal.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from bench.frame import load_frame
from bench.model.drivers import driver_class, manual_of
from bench.model.errors import InputError
from bench.model.installed import offer_of, offers, simulator_module, try_foreign, world_parts
from bench.model.lab import find_beside
from bench.model.ports import actions_of
from bench.model.units import format_quantity, read_quantity
from bench.model.yamlio import parse_yaml
from bench.plan.findings import Draft, Findings, suggestion
from bench.plan.language.graphs import check_graphs
from bench.plan.language.interlocks import OF_UNIT, SIGNALS, Interlock, InterlockRule, rule_of
from bench.plan.language.sequence import Sequence, language_of_sequence
from bench.plan.language.standards import Standard
from bench.plan.station import (
    InstrumentEntry,
    Station,
    StationFile,
    World,
    boards_of,
    driver_actions,
    driver_ladder_A,
    option_mistake,
    option_text,
)

ADAPTER = "adapters"  # in place of a library, for an instrument behind one
SIMULATION = "sim_instruments.worlds.simulation"  # by name: the bench never imports its simulators
_ADDRESS = re.compile(r"(ASRL|GPIB|PRLGX-ASRL|PRLGX-TCPIP|PXI|TCPIP|USB|VICP|VXI)([^:]*)(?:::(.+))?", re.IGNORECASE)
_GIVES = "reach it over GPIB, VXI-11 or HiSLIP, or over USB with 'visa: \"@ivi\"' (docs/instruments.md)"
_KINDS = ("INSTR", "SOCKET", "RAW", "BACKPLANE", "MEMACC", "SERVANT", "INTFC")


def check_station(station: Station, findings: Findings) -> None:
    """Note every mistake of a station that opening it would meet later."""
    draft = Draft(station.document, findings)
    _addresses(draft)
    _links(draft)
    for role, entry in station.instruments.items():
        _driver(draft, role, entry)
    if station.file.world is not None:
        _world(draft, station.file.world)
    check_register(station, findings)
    station_rules(station, findings)
    _graphs(draft)


def canonical_address(resource: str) -> str | None:
    """Return a VISA address in its full form, so that two ways to write it are equal; None if it is no such address.

    ``GPIB::4`` and ``gpib0::4::INSTR`` are both ``GPIB0::4::INSTR``. Source: VPP-4.3, address strings, defaults.
    """
    match = _ADDRESS.fullmatch(resource.strip())
    if match is None:
        return None
    interface, board, rest = match.groups()
    parts = rest.upper().split("::") if rest else []
    kind = parts.pop() if parts and parts[-1] in _KINDS else "INSTR"
    if interface.upper() == "ASRL":
        return None if parts else f"ASRL{board or '0'}::{kind}"  # a device file, where case counts
    if interface.upper() == "GPIB":
        if not all(part.isdecimal() for part in parts) or len(parts) > 2:
            return None
        parts = [str(int(part)) for part in parts]
        parts = parts[:1] if parts[1:] == ["0"] else parts
    if not parts or "" in parts:
        return None
    return "::".join([f"{interface.upper()}{board.upper() or '0'}", *parts, kind])


def _addresses(draft: Draft[StationFile]) -> None:
    taken: dict[str, str] = {}
    for role, entry in draft.model.instruments.items():
        path = ("instruments", role, "resource")
        address = canonical_address(entry.resource)
        if address is None:
            message = f"{role}: {entry.resource!r} is not a VISA address"
            draft.fail("B-PLAN-012", path, message, "write it as GPIB0::4::INSTR; of an alias, what it stands for")
        elif address.endswith("::INTFC"):
            message = f"{role}: {entry.resource!r} is an interface, not an instrument"
            draft.fail("B-PLAN-012", path, message, "name it under 'adapters', and the instrument GPIB0::22::INSTR")
        elif taken.setdefault(address, role) != role:
            message = f"{role} and {taken[address]} both stand at {address}"
            draft.fail("B-PLAN-013", path, message)


def _links(draft: Draft[StationFile]) -> None:
    taken: dict[str, str] = {}
    for name, link in draft.model.links.items():
        path = ("links", name)
        if name in draft.model.instruments:
            draft.fail("B-PLAN-013", path, f"{name!r} is a link and an instrument")
        if link.url is not None and taken.setdefault(link.url, name) != name:
            message = f"the links {name} and {taken[link.url]} both use {link.url}"
            draft.fail("B-PLAN-013", path, message)


def _graphs(draft: Draft[StationFile]) -> None:
    """Graphs are checked against the frames that the unit sends after power on, where those can be read."""
    if not draft.model.graphs:
        return
    frames = {}
    for name, link in draft.model.links.items():
        try:
            frames[name] = load_frame(find_beside(Path(draft.document.name), "frames", link.frame))
        except InputError:
            return  # the sequence that uses the link says so
    check_graphs(draft, frames)


def _driver(draft: Draft[StationFile], role: str, entry: InstrumentEntry) -> None:
    path = ("instruments", role, "driver")
    try:
        driver = driver_class(entry.driver)
    except InputError as error:
        draft.fail(error.code, path, error.message, error.next_step)
        return
    _table(draft, path, entry.driver, {"prepare", "make_safe", *actions_of(driver)})
    _transport(draft, role, entry, driver)
    _limits(draft, role, entry)
    _options(draft, role, entry, driver)
    simulator = simulator_module(entry.driver) if draft.model.simulated else ""
    if simulator:
        try_foreign(simulator, [f"{simulator}:SIMULATOR"])
    if simulator is None:
        message = f"there is no simulator of the driver {entry.driver!r}"
        draft.fail(
            "B-PLAN-016", path, message, f"write sim_instruments/{entry.driver}.py, or use a driver that has one"
        )


def _table(draft: Draft[StationFile], path: tuple[str, ...], driver: str, moments: Collection[str]) -> None:
    """Judge the table beside a driver: what it has wrong, and rows that no action begins with."""
    try:
        manual = manual_of(driver)
    except InputError as error:
        draft.findings.extend(error)
        return
    for name, condition in manual.states.items() if manual else ():
        if strange := [when for when in condition.when if when not in moments]:
            message = f"{driver}.yaml: the row {name!r} waits for {strange[0]!r}{suggestion(strange[0], moments)}"
            draft.fail("B-PLAN-050", path, message, "name an action of the driver, or prepare")


def _transport(draft: Draft[StationFile], role: str, entry: InstrumentEntry, driver: type) -> None:
    judge, behind = getattr(driver, "lacking", None), boards_of(draft.model.adapters)
    library = ADAPTER if entry.resource.split("::")[0].upper() in behind else draft.model.visa
    if judge is not None and (missing := " and no ".join(judge(library, entry.resource))):
        message = f"{role} ({entry.driver}): {entry.resource} through {library!r} gives no {missing}"
        draft.fail("B-PLAN-012", ("instruments", role, "resource"), message, _GIVES)


def _options(draft: Draft[StationFile], role: str, entry: InstrumentEntry, driver: type) -> None:
    known = getattr(driver, "default_options", {})
    wrong = [(option, f"has no option {option!r}{suggestion(option, known)}") for option in entry.options
             if option not in known]  # fmt: skip
    judge = getattr(driver, "wrong_option", None)
    if not wrong and judge is not None and (judged := judge({**known, **entry.options})):
        wrong = [judged]
    for option, why in wrong:
        message = f"{role} ({entry.driver}): {why}"
        draft.fail("B-INST-020", ("instruments", role, "options", option), message, "correct the station file")


def _limits(draft: Draft[StationFile], role: str, entry: InstrumentEntry) -> None:
    """A limit of what no action takes protects nothing, a specification of what none reads leaves readings doubtful."""
    actions = driver_actions(entry.driver)
    for index, line in enumerate(entry.standard.specifications if entry.standard else ()):
        if line.reads not in actions:
            place = ("instruments", role, "standard", "specifications", index, "reads")
            message = f"{role} ({entry.driver}) has no action {line.reads!r}{suggestion(line.reads, actions)}"
            draft.fail("B-PLAN-050", place, message)
    taken = {parameter.name: parameter for action in actions.values() for parameter in action.parameters}
    for name, (lowest, _) in entry.limits.items():
        path, limit = ("instruments", role, "limits", name), read_quantity(lowest)
        if name not in taken:
            message = f"no action of {role} ({entry.driver}) takes {name!r}{suggestion(name, taken)}"
            draft.fail("B-PLAN-095", path, message)
        elif limit is not None and limit[1] != taken[name].dimension:
            message = f"{name} of {role} ({entry.driver}) is no quantity in {limit[1]}"
            draft.fail("B-PLAN-095", path, message, f"write it in {taken[name].dimension or 'no unit at all'}")


def _world(draft: Draft[StationFile], world: World) -> None:
    simulation = import_module(SIMULATION)
    if (offer := offer_of("worlds", world.name)) is None:
        known = suggestion(world.name, [offer.name for offer in offers("worlds")])
        draft.fail("B-PLAN-014", ("world", "name"), f"no world {world.name!r}{known}")
        return
    try_foreign(offer.package, world_parts(offer))
    options = simulation.kind_options(world.name)
    mistakes = {name: option_mistake(name, value, options) for name, value in world.options.items()}
    for name, mistake in mistakes.items():
        if mistake is not None:
            draft.fail(mistake[0], ("world", "options", name), mistake[1])
    if not any(mistakes.values()):
        given = {name: option_text(value) for name, value in world.options.items() if value is not None}
        try:
            simulation.checked_options(world.name, given)
        except InputError as error:
            draft.fail("B-PLAN-015", ("world", "options"), error.message, error.next_step)


def check_register(station: Station, findings: Findings) -> None:
    """Note ranges of the register that the instrument does not have (B-PLAN-065) and, in it, corrections without an
    uncertainty or two lines for one range (B-PLAN-064): such a line would silently not be applied."""
    draft = Draft(station.document, findings)
    for role, entry in station.instruments.items():
        if entry.standard is not None:
            _check_lines(draft, role, entry.driver, entry.standard)


def _check_lines(draft: Draft[StationFile], role: str, driver: str, standard: Standard) -> None:
    lines = {
        "uncertainty": [line.range for line in standard.uncertainty],
        "corrections": [line.range for line in standard.corrections],
    }
    ladder_A: tuple[float, ...] = ()
    with suppress(InputError):  # noted where the drivers are checked
        ladder_A = driver_ladder_A(driver)
    for key, ranges in lines.items():
        times = Counter(ranges)
        for index, range_A in enumerate(ranges):
            path = ("instruments", role, "standard", key, index)
            shown = format_quantity(range_A, "A")
            if times[range_A] > 1:
                draft.fail("B-PLAN-064", path, f"{role}: {key} has {times[range_A]} lines for {shown}", "keep one")
            if range_A not in lines["uncertainty"]:
                known = _listed(lines["uncertainty"])
                message = f"{role}: the correction of {shown} belongs to no range with an uncertainty ({known})"
                draft.fail("B-PLAN-064", path, message, "correct the range, or state its uncertainty")
            if ladder_A and range_A not in ladder_A:
                message = f"{role} has no range {shown}; {driver} has {_listed(ladder_A)}"
                draft.fail("B-PLAN-065", path, message, "write the range as the instrument names it")


def check_used_ranges(station: Station, used_A: Mapping[str, Collection[float]], findings: Findings) -> None:
    """Note each range of a source that the plan uses and the register gives no uncertainty for (B-PLAN-066)."""
    for role, ranges in sorted(used_A.items()):
        certified = station.ranges_A(role)
        missing = [range_A for range_A in sorted(ranges) if range_A not in certified]
        if missing:
            where = station.document.where(("instruments", role, "standard"))
            message = f"{role}: the plan uses {_listed(missing)}; the register has {_listed(certified) or 'no range'}"
            findings.add("B-PLAN-066", where, message, "add the lines of the certificate")


def _listed(ranges_A: Collection[float]) -> str:
    return ", ".join(format_quantity(range_A, "A") for range_A in sorted(ranges_A))


def station_rules(station: Station, findings: Findings) -> dict[str, InterlockRule]:
    """Return rules of a station by name; mistakes are noted."""
    return _rules(station.file.interlocks, Draft(station.document, findings), station)


def plan_rules(draft: Draft[Sequence], station: Station, links: Collection[str]) -> tuple[InterlockRule, ...]:
    """Return rules of a sequence on its station, in order of names. Mistakes of the station are noted by its own check.

    A rule of the station for what the sequence's links do not tell is left out; one of the sequence is a mistake.
    Args:      draft: the sequence.   links: of the units that it measures.
    Findings:  B-PLAN-097 (a signal that comes over a link which the sequence does not name).
    """
    own = _rules(draft.model.interlocks, draft, station)
    for rule in own.values():
        if not _is_told(rule, links):
            message = f"interlock {rule.name}: {rule.signal} comes over a link, and the sequence does not name it"
            draft.findings.add(
                "B-PLAN-097", rule.where, message, "name the link under 'frame', or take the interlock out"
            )
    rules = {**station_rules(station, Findings()), **own}
    return tuple(rules[name] for name in sorted(rules) if _is_told(rules[name], links))


def recorded_rules(text: str, name: str, station: Station, links: Collection[str]) -> tuple[InterlockRule, ...]:
    """Return rules of a sequence that a session with these links holds. Args: name: of the text. Raises: InputError."""
    document = parse_yaml(text, name, language_of_sequence)
    return plan_rules(Draft(document, Findings()), station, links)


def _is_told(rule: InterlockRule, links: Collection[str]) -> bool:
    """Return whether something will tell the signal of a rule: an instrument, or one of the sequence's links."""
    if SIGNALS[rule.signal].of == "link":
        return rule.of in links
    return bool(links) or rule.signal not in OF_UNIT


def _rules(entries: Mapping[str, Interlock], draft: Draft[Any], station: Station) -> dict[str, InterlockRule]:
    made = {name: rule_of(name, entry, draft, station.links, station.instruments) for name, entry in entries.items()}
    return {name: rule for name, rule in made.items() if rule is not None}
