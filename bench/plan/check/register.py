"""Static check of the register of standards: is every range a source uses one that it has and that is certified?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping

from bench.model.errors import InputError
from bench.model.units import format_quantity
from bench.plan.drivers import driver_ladder_A
from bench.plan.findings import Findings
from bench.plan.station import InstrumentEntry, Standard, Station


def check_register(station: Station, findings: Findings) -> None:
    """Note ranges of the register that the instrument does not have (B-PLAN-065) and, in it, corrections without an
    uncertainty or two lines for one range (B-PLAN-064): such a line would silently not be applied."""
    for role, entry in station.instruments.items():
        if entry.standard is not None:
            _check_lines(station, role, entry.standard, findings)
            _check_ladder(station, role, entry, entry.standard, findings)


def _lines(standard: Standard) -> dict[str, list[float]]:
    return {
        "uncertainty": [line.range for line in standard.uncertainty],
        "corrections": [line.range for line in standard.corrections],
    }


def _check_lines(station: Station, role: str, standard: Standard, findings: Findings) -> None:
    lines = _lines(standard)
    for key, ranges in lines.items():
        times = Counter(ranges)
        for index, range_A in enumerate(ranges):
            where = station.document.where(("instruments", role, "standard", key, index))
            shown = format_quantity(range_A, "A")
            if times[range_A] > 1:
                findings.add("B-PLAN-064", where, f"{role}: {key} has {times[range_A]} lines for {shown}", "keep one")
            if range_A not in lines["uncertainty"]:
                known = _listed(lines["uncertainty"])
                message = f"{role}: the correction of {shown} belongs to no range with an uncertainty ({known})"
                findings.add("B-PLAN-064", where, message, "correct the range, or state its uncertainty")


def _check_ladder(station: Station, role: str, entry: InstrumentEntry, standard: Standard, findings: Findings) -> None:
    try:
        ladder_A = driver_ladder_A(entry.driver)
    except InputError:
        return  # noted where the drivers are checked
    for key, ranges in _lines(standard).items() if ladder_A else ():
        for index, range_A in enumerate(ranges):
            if range_A not in ladder_A:
                where = station.document.where(("instruments", role, "standard", key, index))
                message = f"{role} has no range {format_quantity(range_A, 'A')}; {entry.driver} has {_listed(ladder_A)}"
                findings.add("B-PLAN-065", where, message, "write the range as the instrument names it")


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
