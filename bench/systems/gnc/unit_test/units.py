"""Units under test of a session: the static checks, the exchanges by test item, its supply readings, its times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from bench.analysis import Document, Material, Reading
from bench.systems.gnc.limits import Limits, limits_of
from bench.systems.gnc.unit_test.answers import Answer, Findings, Wrong, answers_of
from bench.systems.gnc.unit_test.judges import (
    judge_ad,
    judge_can,
    judge_cpu,
    judge_gps,
    judge_identity,
    judge_imu,
    judge_io,
    judge_memory,
    judge_sci,
    judge_spi,
    judge_static,
    judge_supply,
    judge_timer,
)
from bench.systems.gnc.wording import say

if TYPE_CHECKING:
    from bench.analysis import Exchange, GivenValue

PASS, FAIL, NOT_TESTED = "pass", "fail", "not tested"
STATIC, SUPPLY, IDENTITY = "static", "supply", "identify"
# The six rows of table 1 of the GNC-module paper, then what its section 3 (2) adds.
ITEMS: Mapping[str, str] = {
    "cpu": "CPU",
    "timer": "timer",
    "memory": "memory",
    "imu": "IMU",
    "gps": "GPS",
    "ad": "AD",
    "io": "IO",
    "spi": "SPI",
    "sci": "SCI",
    "can": "CAN",
}


@dataclass(frozen=True)
class ItemResult:
    """One test item of one unit; times in seconds of the bench clock, None if nothing was done.

    ``runs``: how many exchanges there were of the item.   ``retries``: how many commands were sent once more.
    ``judged``: False for an item that no judge knows: it is reported, and neither passes nor fails.
    """

    item: str
    findings: Findings
    runs: int
    begin_s: float | None = None
    end_s: float | None = None
    retries: int = 0
    judged: bool = True

    @property
    def verdict(self) -> str:
        """pass, fail, or not tested."""
        if not self.runs or not self.judged:
            return NOT_TESTED
        return FAIL if self.findings.wrong else PASS


@dataclass(frozen=True)
class UnitResult:
    """Everything about one unit: items in the order of the paper, the supply before them.

    ``static``: the checks before power, None in a session that holds no value of them.
    """

    unit: str
    supply: ItemResult
    items: tuple[ItemResult, ...] = field(default=())
    static: ItemResult | None = None

    @property
    def all(self) -> tuple[ItemResult, ...]:
        """Static checks, supply and items."""
        return (*(() if self.static is None else (self.static,)), self.supply, *self.items)

    @property
    def span_s(self) -> tuple[float, float] | None:
        """Begin of the first and end of the last test, bench clock; the static checks in front do not count."""
        begins = [item.begin_s for item in self.items if item.begin_s is not None]
        ends = [item.end_s for item in self.items if item.end_s is not None]
        return (min(begins), max(ends)) if begins and ends else None

    @property
    def verdict(self) -> str:
        """fail if anything fails; pass only if everything was tested and passes."""
        verdicts = {item.verdict for item in self.all if item.judged}
        if FAIL in verdicts:
            return FAIL
        return PASS if verdicts == {PASS} else NOT_TESTED

    @property
    def wrong(self) -> list[Wrong]:
        """Return every wrong result."""
        return [wrong for item in self.all for wrong in item.findings.wrong]


def unit_results(material: Material) -> list[UnitResult]:
    """Return every unit of a session in the order of its first appearance.

    Raises: FitError B-GNC-001 for limits that are not usable.
    """
    limits = limits_of(material.campaign)
    default = str(material.campaign["uut"]["serial"])
    exchanges: dict[str, list[Exchange]] = {}
    readings: dict[str, list[Reading]] = {}
    for exchange in material.exchanges:
        if exchange.item:
            exchanges.setdefault(unit_of(exchange.conditions, default), []).append(exchange)
    for reading in material.readings:
        readings.setdefault(unit_of(reading.conditions, default), []).append(reading)
    given: dict[str, list[GivenValue]] = {}
    for value in material.given:
        given.setdefault(unit_of(value.conditions, default), []).append(value)
    tested = exchanges or given
    names = dict.fromkeys([*given, *exchanges, *(name for name in readings if name in exchanges or not tested)])
    units = [_unit(name, exchanges.get(name, []), readings.get(name, []), material, limits) for name in names]
    if not given:
        return units
    return [replace(unit, static=_static(given.get(unit.unit, []), limits)) for unit in units]


def _static(given: Sequence[GivenValue], limits: Limits) -> ItemResult:
    times_s = (given[0].t_s, given[-1].t_s) if given else (None, None)
    return ItemResult(STATIC, judge_static(given, limits), len(given), *times_s)


def unit_of(conditions: Document, default: str) -> str:
    """Serial number of the unit that a step was about."""
    return str(conditions.get("unit", default))


def _unit(
    name: str, exchanges: Sequence[Exchange], readings: Sequence[Reading], material: Material, limits: Limits
) -> UnitResult:
    by_item: dict[str, list[Exchange]] = {item: [] for item in ITEMS}
    for exchange in exchanges:
        by_item.setdefault(exchange.item, []).append(exchange)
    judges = _judges(material)
    items = [_item(item, own, judges.get(item), material, limits) for item, own in by_item.items()]
    return UnitResult(name, judge_supply_item(readings, limits), tuple(items))


def judge_supply_item(readings: Sequence[Reading], limits: Limits) -> ItemResult:
    """Return the supply readings of a unit as an item of their own."""
    findings, used = judge_supply(readings, limits)
    if not used:
        return ItemResult(SUPPLY, findings, 0)
    return ItemResult(SUPPLY, findings, len(used), used[0].t_s, used[-1].t_s)


def _judges(material: Material) -> Mapping[str, Callable[[Sequence[Answer], Limits], Findings]]:
    site, imu = material.campaign.get("site") or {}, material.campaign.get("imu") or {}
    return {
        "cpu": judge_cpu,
        "timer": judge_timer,
        "memory": judge_memory,
        "imu": lambda answers, limits: judge_imu(answers, limits, imu),
        "gps": lambda answers, limits: judge_gps(answers, limits, site),
        "ad": judge_ad,
        "io": judge_io,
        "spi": judge_spi,
        "sci": judge_sci,
        "can": judge_can,
        IDENTITY: judge_identity,
    }


def _item(
    item: str, exchanges: Sequence[Exchange], judge: Callable[[Sequence[Answer], Limits], Findings] | None,
    material: Material, limits: Limits,
) -> ItemResult:  # fmt: skip
    if not exchanges:
        return ItemResult(item, Findings(), 0)
    answers = answers_of(exchanges, material.layouts)
    findings = Findings(remarks=[say("remark.unjudged")]) if judge is None else _judged(item, answers, judge, limits)
    retries = sum(exchange.attempts - 1 for exchange in exchanges)
    times_s = exchanges[0].begin_s, exchanges[-1].end_s
    return ItemResult(item, findings, len(exchanges), *times_s, retries, judged=judge is not None)


def _judged(
    item: str, answers: Sequence[Answer], judge: Callable[[Sequence[Answer], Limits], Findings], limits: Limits
) -> Findings:
    """Return what the judge says of the commands of its item; another command under its name is a wrong result."""
    own = [answer for answer in answers if answer.exchange.name == item]
    findings = judge(own, limits) if own else Findings()
    for answer in answers:
        name = answer.exchange.name
        findings.expect(name == item, answer, say("wrong.other_item", name=name), say("wrong.command", item=item), name)
    return findings
