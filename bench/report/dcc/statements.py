"""Statements of a certificate: what it is and is not, coverage, traceability, decision rule, verdicts, restrictions."""

from __future__ import annotations

from collections import Counter

from bench.report.dcc.calibration import TEXTS, Calibration
from bench.report.dcc.elements import Element, dcc, leaf, words
from bench.report.dcc.judged import STATUS
from bench.report.dcc.results import left_out
from bench.report.dcc.standards import overdue

_WORST_FIRST = ("fail", "conditional_fail", "conditional_pass", "pass")


def statements(calibration: Calibration) -> Element:
    """Return the element statements."""
    laboratory = calibration.laboratory
    return dcc(
        "statements",
        *_specimen(calibration),
        _statement(TEXTS("statement.scope"), norm="ISO/IEC 17025:2017", reference="7.8.2.1 l)"),
        _statement(TEXTS("statement.coverage"), "basic_methodMeasurementUncertainty", norm="JCGM 100:2008"),
        _statement(laboratory.traceability, "bench_traceability", norm="ISO/IEC 17025:2017", reference="7.8.4.1 c)"),
        *_overdue(calibration),
        *_conformity(calibration),
        *_not_reported(calibration),
        _quality(calibration),
        *(_statement(note, "bench_note") for note in calibration.results.get("notes", ())),
        *(_statement(text, "bench_laboratoryStatement") for text in laboratory.statements),
    )


def _statement(
    text: str, ref_type: str | None = None, *, norm: str = "", reference: str = "", conformity: str | None = None
) -> Element:
    return dcc(
        "statement",
        leaf("norm", norm),
        leaf("reference", reference),
        words("declaration", text),
        leaf("conformity", conformity),
        refType=ref_type,
    )


def _specimen(calibration: Calibration) -> list[Element]:
    if not calibration.specimen:
        return []
    key = "statement.simulated" if calibration.simulated else "statement.specimen"
    return [_statement(TEXTS(key), "bench_specimen")]


def _overdue(calibration: Calibration) -> list[Element]:
    """Only a specimen can have them: a certificate is refused."""
    late = overdue(calibration.manifest.get("standards", {}), calibration.began, calibration.ended)
    return [_statement(TEXTS("statement.overdue", standards="; ".join(late)), "bench_overdue")] if late else []


def _conformity(calibration: Calibration) -> list[Element]:
    counted = Counter(one["verdict"] for one in calibration.results["estimates"] if one["verdict"] in STATUS)
    if not counted:
        return [_statement(TEXTS("statement.not_judged"), "bench_decisionRule")]
    rule = str(calibration.results.get("decision_rule") or "non_binary")
    worst = next(verdict for verdict in _WORST_FIRST if counted[verdict])
    tally = ", ".join(f"{counted[verdict]} {STATUS[verdict]}" for verdict in _WORST_FIRST if counted[verdict])
    judged = TEXTS("statement.judged", count=sum(counted.values()), tally=tally)
    return [
        _statement(TEXTS(f"rule.{rule}"), "bench_decisionRule", norm="JCGM 106:2012", reference="ILAC-G8:09/2019"),
        _statement(judged, "basic_conformity", conformity=STATUS[worst]),
    ]


def _not_reported(calibration: Calibration) -> list[Element]:
    names = Counter(one["quantity"] for one in calibration.results["estimates"] if left_out(one))
    listed = ", ".join(f"{count} {name}" for name, count in sorted(names.items()))
    return [_statement(TEXTS("statement.left_out", listed=listed), "bench_leftOut")] if names else []


def _quality(calibration: Calibration) -> Element:
    quality = calibration.results["quality"]
    return _statement(TEXTS("statement.quality", **quality), "bench_quality")
