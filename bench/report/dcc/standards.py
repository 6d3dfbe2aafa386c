"""The standards of the register as measuring equipment, and which of them were not valid at the time."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Any

from bench.report.dcc.calibration import TEXTS, Calibration
from bench.report.dcc.elements import Element, dcc, leaf, words

ON_PAPER = "analogue"  # what the good practice of the DCC writes where a certificate has no file and so no hash


def overdue(standards: Mapping[str, Mapping[str, Any]], began: date, ended: date) -> list[str]:
    """Standards whose calibration does not cover the days of the measurement, each with its dates."""
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
    """ID of a standard in the certificate."""
    return f"equipment_{role}"


def _is_valid(entry: Mapping[str, Any], began: date, ended: date) -> bool:
    """False too for a register of other software that does not say when."""
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
            dcc(
                "identification",
                leaf("issuer", "manufacturer"),
                leaf("value", _said(entry, "serial")),
                words("name", TEXTS("identification.serial")),
                refType="basic_serialNumber",
            ),
        ),
        id=equipment_id(role),
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
