"""imu_coefficients.json: what a navigation unit needs to compensate its inertial sensors and its magnetometer.

A document of its own beside coefficients.json, which is about converters: docs/decisions/0016-imu-coefficients.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from bench.analysis import (
    Analysis,
    Closed,
    Source,
    UnitUnderTest,
    same_unit,
    schema_of,
    source_of,
    validate_coefficients,
)
from bench.model.errors import InputError

if TYPE_CHECKING:
    from bench.systems.gnc.estimators.magnetometer.ellipse import PlaneParameters
    from bench.systems.gnc.estimators.triad import TriadFit

NAME = "imu_coefficients"
SECTION = "section"
SIGNS = {
    "axes": "x, y, z of the body, right-handed; rows of a matrix are outputs, columns are indicated axes",
    "accelerometer": "a = K N + bias; a in g (9.80665 m/s2), up positive at rest; N indicated, g",
    "gyro": "w = K N - bias; w in deg/s, right-handed, against inertial space; N indicated, deg/s",
    "magnetometer": "y = gain (y_out - offset_y); x = (x_out - offset_x - y sin(alpha)) / cos(alpha); gauss",
    "roll": "atan2(-y, x); 0 where the field lies along +x, grows while the unit turns right-handed about +z",
    "valid_degC": "lowest and highest mean temperature of the records, by the unit's own sensor",
}
_NEXT = "merge one calibration and one magnetometer session of the same unit"
_Three = Annotated[list[float], Field(min_length=3, max_length=3)]
_Two = Annotated[list[float], Field(min_length=2, max_length=2)]


class TriadSection(Closed):
    """Matrix and bias of three sensors; standard uncertainties beside them."""

    section: Literal["accelerometer", "gyro"]
    unit: Literal["g", "deg/s"]
    matrix: Annotated[list[_Three], Field(min_length=3, max_length=3)]
    matrix_std: Annotated[list[_Three], Field(min_length=3, max_length=3)]
    bias: _Three
    bias_std: _Three
    valid_degC: _Two
    session: str


class MagnetometerSection(Closed):
    """Offset, gain and non-orthogonality of the two axes across the roll axis."""

    section: Literal["magnetometer"]
    unit: Literal["gauss"]
    method: Literal["extremes", "ellipse"]
    offset: _Two
    offset_std: _Two
    gain: Annotated[float, Field(gt=0)]
    gain_std: float
    alpha_deg: Annotated[float, Field(gt=-90.0, lt=90.0)]
    alpha_std_deg: float
    valid_degC: _Two
    session: str


class ImuCoefficients(Closed):
    """The document imu_coefficients.json."""

    schema_version: Literal[1] = Field(alias="schema")
    uut: UnitUnderTest
    simulated: bool
    signs: dict[str, str]
    sections: list[Annotated[TriadSection | MagnetometerSection, Field(discriminator=SECTION)]]
    sources: list[Source]


def triad_section(kind: str, fit: TriadFit, span_degC: tuple[float, float]) -> dict[str, Any]:
    """Entry of ``Analysis.compensation`` for a calibrated triad; accelerometer in g, gyro in deg/s."""
    return {
        SECTION: kind,
        "unit": {"accelerometer": "g", "gyro": "deg/s"}[kind],
        "matrix": fit.matrix.tolist(),
        "matrix_std": fit.matrix_std.tolist(),
        "bias": fit.bias.tolist(),
        "bias_std": fit.bias_std.tolist(),
        "valid_degC": list(span_degC),
    }


def magnetometer_section(method: str, plane: PlaneParameters, span_degC: tuple[float, float]) -> dict[str, Any]:
    """Entry of ``Analysis.compensation`` for a magnetometer; gauss and degrees."""
    std = plane.std.tolist()
    return {
        SECTION: "magnetometer",
        "unit": "gauss",
        "method": method,
        "offset": plane.offset.tolist(),
        "offset_std": std[:2],
        "gain": float(plane.gain),
        "gain_std": std[2],
        "alpha_deg": float(plane.alpha_deg),
        "alpha_std_deg": std[3],
        "valid_degC": list(span_degC),
    }


def coefficients_of(analysis: Analysis, results: Mapping[str, Any], campaign: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document of one session. Raises: InputError B-COEF-006 for a section that is not in the form."""
    session = str(results["session"])
    document = {
        "schema": 1,
        "uut": {name: str(results["uut"][name]) for name in ("model", "serial")},
        "simulated": results["provenance"]["simulated"] is not False,
        "signs": dict(SIGNS),
        "sections": [dict(entry) | {"session": session} for entry in analysis.compensation],
        "sources": [source_of(analysis, results)],
    }
    validate_coefficients(document, session, ImuCoefficients)
    return document


def merged(documents: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return one document of the sessions of one unit: calibration and magnetometer.

    Raises: InputError B-COEF-001 (another unit), B-COEF-002 (a section twice), B-COEF-003 (simulated and real).
    """
    same_unit(documents, _NEXT)
    sections = [section for document in documents for section in document["sections"]]
    seen: dict[str, str] = {}
    for section in sections:
        if section[SECTION] in seen:
            raise InputError(
                "B-COEF-002",
                f"the {section[SECTION]} comes from two sessions",
                where=f"{seen[section[SECTION]]}, {section['session']}",
                next_step=_NEXT,
            )
        seen[section[SECTION]] = section["session"]
    order = ("accelerometer", "gyro", "magnetometer")
    return dict(documents[0]) | {
        "sections": sorted(sections, key=lambda section: order.index(section[SECTION])),
        "sources": [source for document in documents for source in document["sources"]],
    }


def coefficients_schema() -> dict[str, Any]:
    """Return the JSON Schema of imu_coefficients.json, made from the same declarations that check it."""
    return schema_of(ImuCoefficients)
