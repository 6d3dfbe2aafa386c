"""measurementResults of a certificate: methods, software, standards, surroundings and the results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.report.dcc.administrative import ITEM_ID
from bench.report.dcc.calibration import TEXTS, Calibration, Span
from bench.report.dcc.dsi import CELSIUS, ONE, si_number
from bench.report.dcc.elements import Element, dcc, leaf, number_list, si, words
from bench.report.dcc.results import results
from bench.report.dcc.standards import equipment, equipment_id

METHOD_ID, UNCERTAINTY_ID, SOFTWARE_ID = "method_campaign", "method_uncertainty", "software_bench"


def measurement(calibration: Calibration) -> Element:
    """Return the element measurementResults; one measurementResult, the campaign."""
    standards = sorted(calibration.manifest.get("standards", {}))
    refs = [METHOD_ID, UNCERTAINTY_ID, SOFTWARE_ID, *(equipment_id(role) for role in standards)]
    title = str(calibration.manifest.get("title") or calibration.results["campaign"])
    return dcc(
        "measurementResults",
        dcc(
            "measurementResult",
            words("name", calibration.marked(title)),
            dcc("usedMethods", *_methods(calibration.results)),
            dcc("usedSoftware", *_software(calibration)),
            equipment(calibration),
            dcc("influenceConditions", *_surroundings(calibration)),
            results(calibration, refs),
            refId=ITEM_ID,
        ),
    )


def _methods(document: Mapping[str, Any]) -> list[Element]:
    campaign = str(document["campaign"])
    known = TEXTS.all
    own = campaign if f"method.{campaign}" in known else "other"
    reference = known.get(f"method.{own}.reference")
    return [
        dcc(
            "usedMethod",
            words("name", TEXTS(f"method.{own}")),
            words("description", TEXTS(f"method.{own}.description", campaign=campaign, method=document["method"])),
            *(leaf("norm", norm) for norm in known.get(f"method.{own}.norms", "").split("; ")),
            leaf("reference", reference),
            id=METHOD_ID,
        ),
        dcc(
            "usedMethod",
            words("name", TEXTS("method.uncertainty")),
            words("description", TEXTS("statement.coverage")),
            leaf("norm", "JCGM 100:2008"),
            id=UNCERTAINTY_ID,
            refType="basic_methodMeasurementUncertainty",
        ),
    ]


def _software(calibration: Calibration) -> list[Element]:
    """The program that gave the numbers, then the packages it was run with."""
    name, _, release = str(calibration.results["provenance"]["software"]).rpartition(" ")
    recorded = calibration.manifest.get("software", {})
    about = TEXTS("software.recorded", git=recorded.get("git") or "-", python=recorded.get("python") or "-")
    own = dcc(
        "software",
        words("name", name or release),
        leaf("release", f"v{release}"),
        leaf("type", "application"),
        words("description", about),
        id=SOFTWARE_ID,
    )
    packages = {package: version for package, version in recorded.get("packages", {}).items() if package != name}
    return [own, *(_library(package, str(version)) for package, version in sorted(packages.items()))]


def _library(package: str, version: str) -> Element:
    return dcc("software", words("name", package), leaf("release", f"v{version}"), leaf("type", "library"))


def _surroundings(calibration: Calibration) -> list[Element]:
    declared = calibration.laboratory.surroundings
    low, high = declared.temperature
    made = [_temperature("laboratory", Span(low, high), "basic_temperature")]
    if declared.humidity is not None:
        made.append(_range("humidity", declared.humidity, ONE, "basic_humidityRelative"))
    for name, span in (("chamber", calibration.chamber), ("unit", calibration.unit)):
        if span is not None:
            made.append(_temperature(name, span, f"bench_{name}Temperature"))
    if set_points := _set_points(calibration.results):
        quantity = dcc("quantity", number_list([si_number(one) for one in set_points], CELSIUS))
        made.append(_condition("set_points", "bench_setPoints", quantity))
    return made


def _set_points(document: Mapping[str, Any]) -> list[float]:
    """The temperatures that estimates are given for, degC, ascending."""
    found = {one["conditions"].get("temperature_degC") for one in document["estimates"]}
    return sorted(float(one) for one in found if isinstance(one, (int, float)))


def _temperature(name: str, span: Span, ref_type: str) -> Element:
    return _range(name, (span.low_degC, span.high_degC), CELSIUS, ref_type)


def _range(name: str, pair: tuple[float, float], unit: str, ref_type: str) -> Element:
    ends = [
        dcc(
            "quantity",
            words("name", TEXTS(f"surroundings.{end.lower()}")),
            si("real", si("value", text=si_number(value)), si("unit", text=unit)),
            refType=f"{ref_type}{end}",
        )
        for end, value in zip(("Min", "Max"), pair, strict=True)
    ]
    return _condition(name, ref_type, *ends)


def _condition(name: str, ref_type: str, *quantities: Element) -> Element:
    return dcc(
        "influenceCondition",
        words("name", TEXTS(f"surroundings.{name}")),
        words("description", TEXTS(f"surroundings.{name}.source")),
        dcc("data", *quantities),
        refType=ref_type,
    )
