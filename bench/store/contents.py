"""Rows for the tables of the history, of results.json and the manifest of a session: pure, no database.

That includes what a standard adds to every calibration made with the same certificate of it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.analysis import Estimate, estimates_of, is_sound, of_check_standard, of_serial, without_check_standard
from bench.model.clock import utc_of_stamp
from bench.model.systems import analysis_declaration
from bench.store.errors import StoreError
from bench.store.tables import COLUMNS

Row = dict[str, Any]

# Conditions that are results themselves: no two calibrations agree in them, so they do not name a parameter.
MEASURED = ("unit_temperature_degC",)
# Table 1 of the AF-converter paper is a stability specification: it limits how far these may move.
_CHANGES = {"dsf_n": "stability_limit_ppm", "dsf_p": "stability_limit_ppm"}
_LAST_NS = 2**63
_STORED = {"quantity", "unit", "conditions", "limit", *COLUMNS}
_PPM = 1e6
_GENERATOR_LIMIT = 3e-6  # rectangular; where the register states nothing (AF-converter paper, section 4.1)

# Quantity -> role of the standard whose relative error enters it one to one, whatever the campaign is.
_ROLES = {"master_clock_error": "function_generator"}


@dataclass(frozen=True)
class Contents:
    """Rows of one session, without the keys that the database gives."""

    calibration: Row
    standards: Sequence[Row]
    shared: Sequence[Row]
    result_set: Row
    quality: Sequence[Row]
    parameters: Sequence[Row]  # one per estimate, in its order
    estimates: Sequence[Row]  # the sound ones
    doubts: Sequence[Row]  # the others


def canonical(document: Any) -> str:
    """Return the one text of a JSON document: sorted keys, shortest exact floats."""
    return json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def digest(text: str) -> str:
    """Return SHA-256 of a text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def digest_of_file(path: Path) -> str:
    """Return SHA-256 of a file, hexadecimal. Raises: OSError."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def started_utc_ns(session: str) -> int | None:
    """Return when a session began, by its name (``20260401T080000Z_...``); None without one, or not before 2262."""
    began_ns = utc_of_stamp(session)
    return began_ns if began_ns is not None and began_ns < _LAST_NS else None


def contents_of(document: Mapping[str, Any], manifest: Mapping[str, Any], started_ns: int | None) -> list[Contents]:
    """Return rows of a session for each of its units. Raises: StoreError B-STORE-008: what they do not say."""
    try:
        return [_contents(of_unit, manifest, started_ns) for of_unit in documents_of_units(document, manifest)]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise StoreError(
            "B-STORE-008",
            f"results.json or the manifest does not say what the history needs ({type(error).__name__} {error})",
            where=str(document.get("session", "results.json")),
            next_step="fit the session again with 'bench fit'; do not edit results by hand",
        ) from error


def _contents(document: Mapping[str, Any], manifest: Mapping[str, Any], started_ns: int | None) -> Contents:
    provenance = document["provenance"]
    session = str(document["session"])
    began_ns = started_utc_ns(session) if started_ns is None else started_ns
    if began_ns is None:
        raise ValueError(f"when {session!r} was taken")
    calibration = {
        "session": session,
        "session_sha256": str(provenance["session_sha256"]),
        "campaign": str(document["campaign"]),
        "uut_model": str(document["uut"]["model"]),
        "uut_serial": str(document["uut"]["serial"]),
        "started_utc_ns": began_ns,
        "simulated": bool(provenance["simulated"]),
        "sequence": str(manifest.get("sequence", "")),
        "station": str(manifest.get("station", "")),
        "plan_sha256": str(provenance["plan_sha256"]),
        "frame_sha256": str(provenance["frame_sha256"]),
    }
    limits, entries = _change_limits(manifest), estimates_of(document)
    numbered = list(enumerate(entries))
    result_set = {
        "results_sha256": digest(canonical(document)),
        "method": str(document["method"]),
        "software": str(provenance["software"]),
        "decision_rule": _text_or_none(document.get("decision_rule")),
        "notes": canonical(list(document["notes"])),
        "estimates": len(entries),
    }
    return Contents(
        calibration=calibration,
        standards=[_standard(role, entry) for role, entry in sorted(manifest.get("standards", {}).items())],
        shared=shared_components(manifest.get("standards", {}), str(document["campaign"])),
        result_set=result_set,
        quality=[{"name": name, "count": int(count)} for name, count in sorted(document["quality"].items())],
        parameters=[parameter_row(entry.quantity, entry.unit, entry.conditions) for entry in entries],
        estimates=[_estimate(number, entry, limits) for number, entry in numbered if is_sound(entry)],
        doubts=[_doubt(number, entry) for number, entry in numbered if not is_sound(entry)],
    )


def _text_or_none(value: Any) -> str | None:
    return value if value is None or isinstance(value, str) else canonical(value)


def _standard(role: str, entry: Mapping[str, Any]) -> Row:
    traceability = entry.get("traceability_relative")
    texts = {name: str(entry.get(name, "")) for name in ("model", "serial", "certificate", "calibrated", "due")}
    return {"role": role, **texts, "traceability_relative": None if traceability is None else float(traceability)}


def parameter_row(quantity: str, unit: str, conditions: Mapping[str, Any]) -> Row:
    """Return the parameter that an estimate is a value of, with its hash; what was measured does not belong to it."""
    given = {name: value for name, value in conditions.items() if name not in MEASURED}
    row = {"quantity": quantity, "unit": unit, "conditions": canonical(given)}
    return {**row, "sha256": digest(canonical(row))}


def _estimate(position: int, entry: Estimate, limits: Mapping[tuple[str, Any], float]) -> Row:
    measured = {name: entry.conditions[name] for name in MEASURED if name in entry.conditions}
    document = entry.document
    further = {name: value for name, value in document.items() if name not in _STORED}
    return {
        "position": position,
        **{name: document[name] for name in COLUMNS},
        "limit_value": entry.limit,
        "change_limit": limits.get((entry.quantity, entry.conditions.get("channel"))),
        "measured": canonical(measured) if measured else None,
        "further": canonical(further) if further else None,
    }


def _doubt(position: int, entry: Estimate) -> Row:
    return {"position": position, "verdict": entry.verdict, "document": canonical(entry.document)}


def _change_limits(manifest: Mapping[str, Any]) -> dict[tuple[str, Any], float]:
    """Return stability limits by quantity and channel, as the campaign declares them."""
    return {
        (quantity, channel["number"]): float(channel[key])
        for quantity, key in _CHANGES.items()
        for channel in manifest["campaign"].get("channels", ())
        if channel.get(key) is not None
    }


def documents_of_units(document: Mapping[str, Any], manifest: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return one document per unit if every estimate names its unit (condition ``unit``), else the document itself;
    a check standard is a unit of its own.

    The serial number is the unit's, the condition is gone: the same unit in another session has the same parameters.
    """
    campaign = manifest["campaign"]
    checked, document = of_check_standard(document, campaign), without_check_standard(document, campaign)
    further = [] if checked is None else [checked]
    estimates = document["estimates"]
    serials = dict.fromkeys(entry["conditions"].get("unit") for entry in estimates)
    if not serials or not all(isinstance(serial, str) for serial in serials):
        return [document, *further]
    return [*(_of(document, str(serial)) for serial in serials), *further]


def _of(document: Mapping[str, Any], serial: str) -> Mapping[str, Any]:
    estimates = [
        {**entry, "conditions": {name: value for name, value in entry["conditions"].items() if name != "unit"}}
        for entry in document["estimates"]
        if entry["conditions"]["unit"] == serial
    ]
    return of_serial(document, serial, estimates)


def shared_components(standards: Mapping[str, Mapping[str, Any]], campaign: str) -> list[dict[str, Any]]:
    """Return one row per quantity that takes over the relative error of a standard.

    Of the ranges of a standard the smallest relative uncertainty is taken: no range shares less than that, and what
    is not known to be shared stays an uncertainty of the single calibration. A standard without serial number or
    certificate is shared with nobody.
    """
    components = []
    declared = analysis_declaration(campaign)
    for quantity, role in {**({} if declared is None else declared.standards), **_ROLES}.items():
        entry = standards.get(role)
        if entry is None or not (entry.get("serial") and entry.get("certificate")):
            continue
        relative = _relative_std(entry, role)
        if relative:
            components.append(
                {
                    "quantity": quantity,
                    "unit": "ppm",
                    "role": role,
                    "standard": f"{entry.get('model', '')} {entry['serial']} {entry['certificate']}",
                    "std_uncertainty": relative * _PPM,
                }
            )
    return components


def _relative_std(entry: Mapping[str, Any], role: str) -> float:
    """Return relative standard uncertainty of the standard with its certificate's; the register states 95 %."""
    lines = [line for line in entry.get("uncertainty") or () if line.get("relative") is not None]
    stated = [float(line["relative"]) / 2.0 for line in lines]
    if not stated and role == "function_generator":
        stated = [_GENERATOR_LIMIT / math.sqrt(3.0)]
    traceability = float(entry.get("traceability_relative") or 0.0) / 2.0
    return math.hypot(min(stated), traceability, _calibration_std(lines)) if stated else 0.0


def _calibration_std(lines: Sequence[Mapping[str, Any]]) -> float:
    """Return the least that the calibrations of a standard's ranges bring to a result of any mean over its ranges."""
    stds = [float(line.get("certificate_U", 0.0)) / float(line.get("k", 2.0)) for line in lines]
    if not stds or min(stds) == 0.0:
        return 0.0
    one_error = len({line.get("common_with") for line in lines}) == 1 and "common_with" in lines[0]
    return min(stds) if one_error else math.fsum(std**-2 for std in stds) ** -0.5
