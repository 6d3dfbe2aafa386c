"""A made-up calibration for the tests of the certificate, and a reader that knows nothing of the writer."""

import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date
from decimal import Decimal
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from bench.report.dcc import Calibration, Span
from bench.report.laboratory import load_laboratory

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "docs" / "laboratory.yaml"
NS = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
SEED = 20260101
UNITS = ("ppm", "A", "ppm/degC", "A/degC2", "degC", "min", "A*s^0.5", "A/h^0.5")


def estimate(quantity: str, unit: str, value: float, expanded: float, **more: Any) -> dict[str, Any]:
    given = {
        "quantity": quantity, "unit": unit, "value": value, "std_uncertainty": expanded / 2, "coverage_factor": 2.0,
        "expanded_uncertainty": expanded, "conditions": {"channel": 1}, "n": 14, "dropped": 0, "limit": None,
        "verdict": "none", "conformance_probability": None,
    }  # fmt: skip
    return given | more


def judged(value: float, verdict: str, **more: Any) -> dict[str, Any]:
    more = {"limit": 100.0, "verdict": verdict, "conformance_probability": 0.5} | more
    return estimate("dsf_n_residual", "ppm", value, 10.0, **more)


def many_estimates(seed: int = SEED) -> list[dict[str, Any]]:
    """Estimates with awkward digits, several sorts of conditions, units and verdicts."""
    rng = random.Random(seed)
    found = [
        estimate(
            f"quantity_{index}", unit, rng.gauss(0, 1) * 10.0 ** rng.randint(-14, 6), rng.random() * 1e-7,
            coverage_factor=1.0 + rng.random() * 12.0, n=rng.randint(1, 900), dropped=rng.randint(0, 3),
            conditions={"channel": channel, "kind": "gyro", "temperature_degC": -10.0 + 15.1 * channel},
        )
        for index, unit in enumerate(UNITS) for channel in (1, 2, 3)
    ]  # fmt: skip
    found += [judged(rng.gauss(0, 60), verdict) for verdict in ("pass", "fail", "conditional_pass", "conditional_fail")]
    found.append(
        estimate("drift", "ppm", 1.5, 0.5, conditions={"check": "closing repeat", "hours": 5.0, "closed": True})
    )
    found.append(estimate("drift", "ppm", 2.5, 0.5, conditions={"check": "other", "hours": 6.0, "closed": False}))
    found.append(estimate("few", "A", 1e-9, 2e-9, dof=3.7, coverage_factor=3.18))
    found.append(estimate("few", "A", 0.0, 0.0))
    return found


def standard(**more: Any) -> dict[str, Any]:
    given = {
        "model": "5720A", "serial": "12", "certificate": "C-1", "calibrated": "2025-11-01", "due": "2026-11-01",
        "corrections": [], "uncertainty": [], "driver": "fluke_5720a",
    }  # fmt: skip
    return given | more


def calibration(*, estimates: list[dict[str, Any]] | None = None, **more: Any) -> Calibration:
    """A real calibration unless told otherwise (``specimen``, ``simulated``)."""
    simulated = more.pop("simulated", False)
    results = {
        "schema": 1, "session": "20260101T180000Z_scale_factor_38h_17", "campaign": "scale_factor", "method": "gls",
        "uut": {"model": "NGU", "serial": "17"}, "decision_rule": "non_binary",
        "estimates": many_estimates() if estimates is None else estimates,
        "quality": {"records": 9, "frames": 8, "frames_bad": 7, "frames_lost": 6, "splices": 5, "retaken": 4},
        "provenance": {"simulated": simulated, "software": "inertial-bench 0.1.0", "session_sha256": "5" * 64},
        "notes": ["A restriction of the results."],
    }  # fmt: skip
    manifest = {
        "title": "A campaign", "standards": {"calibrator": standard(), "dmm": standard(model="3458A", serial="34")},
        "identities": {"calibrator": {"manufacturer": "FLUKE"}},
        "software": {"git": "abc", "python": "3.11.7", "packages": {"numpy": "2.4.6", "inertial-bench": "0.1.0"}},
    }  # fmt: skip
    made = Calibration(
        results=results, manifest=manifest, laboratory=load_laboratory(EXAMPLE),
        hashes={"session": "5" * 64, "results": "a" * 64, "report": "b" * 64}, began=date(2026, 1, 1),
        ended=date(2026, 1, 3), issued=date(2026, 1, 9), chamber=Span(-40.1, 60.2), unit=Span(-39.0, 63.5),
    )  # fmt: skip
    return replace(made, **more)


@dataclass(frozen=True)
class ReadEstimate:
    """One value as a stranger reads it; numbers exactly as decimals, in the D-SI unit."""

    quantity: str
    unit: str
    value: Decimal
    expanded: Decimal
    factor: Decimal
    probability: Decimal
    conditions: tuple[tuple[str, str], ...]
    conformity: str | None
    limits: tuple[Decimal, Decimal] | None
    counts: tuple[Decimal, Decimal]


def read_certificate(xml: bytes) -> list[ReadEstimate]:
    """Every value of every table, row by row."""
    found: list[ReadEstimate] = []
    for table in ET.fromstring(xml).iterfind(".//dcc:results/dcc:result/dcc:data/dcc:list", NS):
        found += _rows(table)
    return found


def _rows(table: ET.Element) -> list[ReadEstimate]:
    columns = {one.findtext("dcc:name/dcc:content", "", NS): one for one in table.iterfind("dcc:quantity", NS)}
    values = next(one for one in columns.values() if "basic_measuredValue" in one.get("refType", ""))
    names = [name for name, one in columns.items() if one is not values and not one.get("refType", "x_").endswith(
        ("bench_n", "bench_dropped", "bench_dof"))]  # fmt: skip
    size = len(values.findtext(".//si:valueXMLList", "", NS).split())
    counts = [
        _list(table.find(f"dcc:quantity[@refType='bench_{one}']", NS), "valueXMLList", size) for one in ("n", "dropped")
    ]
    statuses = values.findtext(".//dcc:conformityXMLList", "", NS).split() or [None] * size
    wanted = ("value", "unit", "uncertainty", "coverageFactor", "coverageProbability")
    lists = {f"{name}XMLList": _list(values, f"{name}XMLList", size) for name in wanted}
    conditions = {name: _condition(columns[name], size) for name in names}
    limits = [_limits(values, end, size) for end in ("Lower", "Upper")]
    return [
        ReadEstimate(
            quantity=values.get("refType", "").removeprefix("basic_measuredValue bench_"),
            unit=lists["unitXMLList"][row],
            value=Decimal(lists["valueXMLList"][row]),
            expanded=Decimal(lists["uncertaintyXMLList"][row]),
            factor=Decimal(lists["coverageFactorXMLList"][row]),
            probability=Decimal(lists["coverageProbabilityXMLList"][row]),
            conditions=tuple(sorted((name, column[row]) for name, column in conditions.items())),
            conformity=statuses[row],
            limits=(limits[0][row], limits[1][row]) if limits[0] else None,
            counts=(Decimal(counts[0][row]), Decimal(counts[1][row])),
        )
        for row in range(size)
    ]


def _list(quantity: ET.Element | None, name: str, size: int) -> list[str]:
    """A list of one entry holds for all, as D-SI has it. Only that of the quantity itself, not of its metadata."""
    found = quantity.findtext(f"si:realListXMLList//si:{name}", "", NS).split()
    assert len(found) in (1, size), name
    return found * size if len(found) == 1 else found


def _limits(values: ET.Element, end: str, size: int) -> list[Decimal]:
    found = values.find(f".//dcc:quantity[@refType='basic_toleranceLimit{end}']", NS)
    return [] if found is None else [Decimal(text) for text in _list(found, "valueXMLList", size)]


def _condition(column: ET.Element, size: int) -> list[str]:
    words = column.findtext("dcc:charsXMLList", "", NS).split()
    if words:
        assert len(words) == size
        return words
    sentence = column.findtext("dcc:noQuantity/dcc:content", None, NS)
    return [sentence] * size if sentence is not None else _list(column, "valueXMLList", size)


def expected(estimate_: Mapping[str, Any], unit: str) -> ReadEstimate:
    """What a stranger should read of an estimate; by decimal arithmetic on the digits of results.json."""
    power = Decimal(10) ** (-6 if estimate_["unit"].startswith("ppm") else 0)
    statuses = {"none": None, "conditional_pass": "conditionalPass", "conditional_fail": "conditionalFail"}
    limit = estimate_["limit"]
    exact = {
        name: Decimal(repr(float(estimate_[name]))) for name in ("value", "expanded_uncertainty", "coverage_factor")
    }
    conditions = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in estimate_["conditions"].items()
    }
    return ReadEstimate(
        quantity=estimate_["quantity"], unit=unit, value=exact["value"] * power,
        expanded=exact["expanded_uncertainty"] * power, factor=exact["coverage_factor"], probability=Decimal("0.95"),
        conditions=tuple(sorted(conditions.items())),
        conformity=statuses.get(estimate_["verdict"], estimate_["verdict"]),
        limits=None if limit is None else (Decimal(repr(-limit)) * power, Decimal(repr(limit)) * power),
        counts=(Decimal(estimate_["n"]), Decimal(estimate_["dropped"])),
    )  # fmt: skip
