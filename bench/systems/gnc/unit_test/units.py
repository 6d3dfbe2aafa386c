"""Units under test of a session: the static checks, the exchanges by test item, its supply readings, its times."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from bench.analysis import Document, Exchange, GivenValue, Material, Reading
from bench.systems.gnc.limits import limits_of
from bench.systems.gnc.unit_test.answers import Answer, Findings, Wrong, answers_of
from bench.systems.gnc.unit_test.judges import IDENTITY, JUDGES, Rules, judge, judge_static, judge_supply
from bench.systems.gnc.wording import say

Told = TypeVar("Told", Exchange, Reading, GivenValue)
PASS, FAIL, NOT_TESTED = "pass", "fail", "not tested"
STATIC, SUPPLY = "static", "supply"
ITEMS = tuple(item for item in JUDGES if item != IDENTITY)


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
    campaign = material.campaign
    rules = Rules(limits_of(campaign), campaign.get("imu") or {}, campaign.get("site") or {})
    default = str(campaign["uut"]["serial"])
    exchanges = _by_unit([exchange for exchange in material.exchanges if exchange.item], default)
    readings, given = _by_unit(material.readings, default), _by_unit(material.given, default)
    tested = exchanges or given
    names = dict.fromkeys([*given, *exchanges, *(name for name in readings if name in exchanges or not tested)])
    units = []
    for name in names:
        by_item: dict[str, list[Exchange]] = {item: [] for item in ITEMS}
        for exchange in exchanges.get(name, []):
            by_item.setdefault(exchange.item, []).append(exchange)
        items = [_item(item, own, rules, material) for item, own in by_item.items()]
        supply = _read(SUPPLY, *judge_supply(readings.get(name, []), rules.limits))
        values = given.get(name, [])
        static = _read(STATIC, judge_static(values, rules.limits), values) if given else None
        units.append(UnitResult(name, supply, tuple(items), static))
    return units


def _by_unit(entries: Iterable[Told], default: str) -> dict[str, list[Told]]:
    by_unit: dict[str, list[Told]] = {}
    for entry in entries:
        by_unit.setdefault(unit_of(entry.conditions, default), []).append(entry)
    return by_unit


def _read(item: str, findings: Findings, used: Sequence[Reading] | Sequence[GivenValue]) -> ItemResult:
    """Return what was read or given of a unit as an item of its own."""
    times_s = (used[0].t_s, used[-1].t_s) if used else (None, None)
    return ItemResult(item, findings, len(used), *times_s)


def unit_of(conditions: Document, default: str) -> str:
    """Serial number of the unit that a step was about."""
    return str(conditions.get("unit", default))


def _item(item: str, exchanges: Sequence[Exchange], rules: Rules, material: Material) -> ItemResult:
    if not exchanges:
        return ItemResult(item, Findings(), 0)
    answers = answers_of(exchanges, material.layouts)
    known = item in JUDGES
    findings = _judged(item, answers, rules) if known else Findings(remarks=[say("remark.unjudged")])
    retries = sum(exchange.attempts - 1 for exchange in exchanges)
    times_s = exchanges[0].begin_s, exchanges[-1].end_s
    return ItemResult(item, findings, len(exchanges), *times_s, retries, judged=known)


def _judged(item: str, answers: Sequence[Answer], rules: Rules) -> Findings:
    """Return what the judge says of the commands of its item; another command under its name is a wrong result."""
    own = [answer for answer in answers if answer.exchange.name == item]
    findings = judge(item, own, rules) if own else Findings()
    for answer in answers:
        name = answer.exchange.name
        findings.expect(name == item, answer, say("wrong.other_item", name=name), say("wrong.command", item=item), name)
    return findings
