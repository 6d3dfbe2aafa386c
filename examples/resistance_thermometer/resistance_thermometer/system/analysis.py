"""Thermometers beside a reference probe: deviations from IEC 60751, tolerance classes, own coefficients.

Source: IEC 60751:2022 (equations, classes); EURAMET cg-8 and JCGM 100:2008 (what makes a comparison uncertain).
"""

from __future__ import annotations

from bench.analysis import Analysis, Material, check_method, rule_of
from bench.model.errors import FitError

from resistance_thermometer.system.comparison import compare
from resistance_thermometer.system.estimates import estimates_of
from resistance_thermometer.system.figures import figures_of
from resistance_thermometer.system.notes import cold_notes, doubts_of, missing_of
from resistance_thermometer.system.points import points_of
from resistance_thermometer.system.setup import setup_of
from resistance_thermometer.system.tables import components_of, tables_of

METHODS: tuple[str, ...] = ("callendar_van_dusen",)


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Compare every thermometer with the reference at every record, judge it by its class, fit its own curve.

    Raises: FitError B-FIT-004 for an unknown method, RT-SET-001, RT-SET-002 for what the manifest lacks, RT-SET-003 if
            no record can be used.
    """
    check_method(method, METHODS)
    setup = setup_of(material.campaign, material.standards)
    points = points_of(material)
    if not points:
        raise FitError("RT-SET-003", "no record can be used", next_step="see the quality of the records in the report")
    comparisons = [compare(thermometer, points, setup) for thermometer in setup.thermometers]
    doubts = doubts_of(comparisons, points, setup)
    return Analysis(
        campaign="resistance_thermometer",
        method=method,
        uut=dict(material.campaign["uut"]),
        estimates=[entry for comparison in comparisons for entry in estimates_of(comparison)],
        components=components_of(comparisons),
        notes=[*doubts, *cold_notes(comparisons)],
        missing=missing_of(comparisons),
        figures=figures_of(comparisons),
        tables=tables_of(comparisons, doubts, rule_of(material.campaign.get("decision"))),
    )
