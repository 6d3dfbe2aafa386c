"""measurementResults of a certificate: methods, software, surroundings and the results.

The standards of the register are its measuring equipment; some may not have been valid at the time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

from bench.analysis import Estimates
from bench.model.texts import ENGLISH, Texts, campaign_title
from bench.report.dcc.calibration import FOLDER, ITEM_ID, TEXTS, Calibration, Span
from bench.report.dcc.dsi import CELSIUS, ONE, si_number
from bench.report.dcc.elements import Element, dcc, leaf, number_list, si, words
from bench.report.dcc.results import results

METHOD_ID, UNCERTAINTY_ID, SOFTWARE_ID = "method_campaign", "method_uncertainty", "software_bench"
ON_PAPER = "analogue"  # what the good practice of the DCC writes where a certificate has no file and so no hash


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


@dataclass(frozen=True)
class Method:
    """The method of an analysis in words; ``reference``: the page with its equations, "" without one."""

    name: str
    description: str
    reference: str
    norms: tuple[str, ...]


def method_of(document: Mapping[str, Any], language: str = ENGLISH) -> Method:
    """Return the method that the results of a session were obtained by; ``document``: of results.json.

    ``language``: of its description; a certificate is in English.
    """
    campaign, known = str(document.get("campaign", "")), TEXTS.all
    own = campaign if f"method.{campaign}" in known else "other"
    told = Texts(FOLDER, language)
    description = told(
        f"method.{own}.description", campaign=campaign_title(campaign, language), method=document.get("method", "–")
    )
    norms = known.get(f"method.{own}.norms", "").split("; ")
    return Method(TEXTS(f"method.{own}"), description, known.get(f"method.{own}.reference", ""), tuple(norms))


def _methods(document: Mapping[str, Any]) -> list[Element]:
    method = method_of(document)
    return [
        dcc(
            "usedMethod",
            words("name", method.name),
            words("description", method.description),
            *(leaf("norm", norm) for norm in method.norms),
            leaf("reference", method.reference and TEXTS("reference", path=method.reference)),
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
    """Return the program that gave the numbers, then the packages it was run with."""
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
    if set_points := _set_points(calibration.estimates):
        quantity = dcc("quantity", number_list([si_number(set_point) for set_point in set_points], CELSIUS))
        made.append(_condition("set_points", "bench_setPoints", quantity))
    return made


def _set_points(estimates: Estimates) -> list[float]:
    """Return the temperatures that estimates are given for, degC, ascending."""
    temperatures = {estimate.conditions.get("temperature_degC") for estimate in estimates}
    return sorted(float(temperature) for temperature in temperatures if isinstance(temperature, int | float))


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


def overdue(standards: Mapping[str, Mapping[str, Any]], began: date, ended: date) -> list[str]:
    """Return standards whose calibration does not cover the days of the measurement, each with its dates."""
    return [
        f"{role} ({_said(entry, 'model')}, {_said(entry, 'serial')}): {_dates(entry)}"
        for role, entry in sorted(standards.items())
        if not _is_valid(entry, began, ended)
    ]


def equipment(calibration: Calibration) -> Element | None:
    """Return the element measuringEquipments; None if the register is empty."""
    standards = calibration.manifest.get("standards", {})
    made = [_standard(calibration, role, entry) for role, entry in sorted(standards.items())]
    return dcc("measuringEquipments", *made) if made else None


def equipment_id(role: str) -> str:
    """Return ID of a standard in the certificate."""
    return f"equipment_{role}"


def _is_valid(entry: Mapping[str, Any], began: date, ended: date) -> bool:
    """Return False too for a register of other software that does not say when."""
    try:
        calibrated, due = (date.fromisoformat(_said(entry, name)) for name in ("calibrated", "due"))
    except ValueError:
        return False
    return calibrated <= began and ended <= due


def _said(entry: Mapping[str, Any], name: str) -> str:
    return str(entry.get(name) or TEXTS("standard.unknown"))


def _dates(entry: Mapping[str, Any]) -> str:
    return TEXTS("standard.dates", calibrated=_said(entry, "calibrated"), due=_said(entry, "due"))


def _standard(calibration: Calibration, role: str, entry: Mapping[str, Any]) -> Element:
    maker = calibration.manifest.get("identities", {}).get(role, {}).get("manufacturer")
    return dcc(
        "measuringEquipment",
        words("name", f"{role.replace('_', ' ')}: {_said(entry, 'model')}"),
        words("description", _dates(entry)),
        _certificate(calibration, entry),
        dcc("manufacturer", words("name", str(maker))) if maker else None,
        leaf("model", _said(entry, "model")),
        dcc(
            "identifications",
            identification("basic_serialNumber", _said(entry, "serial"), "identification.serial", "manufacturer"),
        ),
        id=equipment_id(role),
    )


def identification(ref_type: str, value: str, key: str, issuer: str = "calibrationLaboratory") -> Element:
    """Return the element identification; ``key``: of its name in words."""
    return dcc(
        "identification", leaf("issuer", issuer), leaf("value", value), words("name", TEXTS(key)), refType=ref_type
    )


def _certificate(calibration: Calibration, entry: Mapping[str, Any]) -> Element:
    valid = _is_valid(entry, calibration.began, calibration.ended)
    return dcc(
        "certificate",
        words("referral", TEXTS("standard.certificate")),
        leaf("referralID", _said(entry, "certificate")),
        leaf("procedure", ON_PAPER),
        leaf("value", ON_PAPER),
        leaf("inValidityRange", "true" if valid else "false"),
        leaf("traceable", "false") if calibration.simulated else None,
    )
