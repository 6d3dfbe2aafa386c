"""imu_coefficients.json: what a navigation unit needs to compensate its inertial sensors and its magnetometer, and the
same as a C99 header with the functions that apply it.

A document of its own beside coefficients.json, which is about converters: docs/method-gnc.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from bench.analysis import (
    Analysis,
    Closed,
    CoefficientsFile,
    Document,
    Source,
    c_header,
    coefficients_document,
    merged_document,
    of_session,
    schema_of,
)

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
_TYPE = """\
/* Sections that were measured: 1, else 0; a function for what was not measured is not there. */
#define IMU_HAS_ACCELEROMETER {accelerometer}
#define IMU_HAS_GYRO {gyro}
#define IMU_HAS_MAGNETOMETER {magnetometer}
"""

_TRIAD = """\
static const double {name}_MATRIX[3][3] = {matrix};
static const double {name}_BIAS[3] = {bias}; /* {unit} */
static const double {name}_VALID_DEGC[2] = {valid};

/* {sign} */
static inline void {function}(const double indicated[3], double compensated[3])
{{
    int row;
    for (row = 0; row < 3; ++row) {{
        compensated[row] = {name}_MATRIX[row][0] * indicated[0] + {name}_MATRIX[row][1] * indicated[1]
                         + {name}_MATRIX[row][2] * indicated[2] {operator} {name}_BIAS[row];
    }}
}}
"""

_MAGNETOMETER = """\
static const double IMU_MAGNETOMETER_OFFSET[2] = {offset}; /* gauss */
static const double IMU_MAGNETOMETER_GAIN = {gain};
static const double IMU_MAGNETOMETER_SIN_ALPHA = {sine};
static const double IMU_MAGNETOMETER_COS_ALPHA = {cosine};
static const double IMU_MAGNETOMETER_VALID_DEGC[2] = {valid};

/* {sign} */
static inline void imu_compensate_magnetometer(const double indicated[2], double compensated[2])
{{
    const double y = IMU_MAGNETOMETER_GAIN * (indicated[1] - IMU_MAGNETOMETER_OFFSET[1]);
    compensated[0] = (indicated[0] - IMU_MAGNETOMETER_OFFSET[0] - y * IMU_MAGNETOMETER_SIN_ALPHA)
                   / IMU_MAGNETOMETER_COS_ALPHA;
    compensated[1] = y;
}}
"""


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


class ImuCoefficients(CoefficientsFile):
    """The document imu_coefficients.json."""

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


def coefficients_of(analysis: Analysis, results: Document, campaign: Document) -> Document:
    """Return the document of one session. Raises: InputError B-COEF-006 for a section that is not in the form."""
    return coefficients_document(ImuCoefficients, analysis, results, SIGNS, sections=of_session(analysis, results))


def merged(documents: Sequence[Document]) -> Document:
    """Return one document of the sessions of one unit: calibration and magnetometer.

    Raises: InputError B-COEF-001 (another unit), B-COEF-002 (a section twice), B-COEF-003 (simulated and real).
    """
    order = ("accelerometer", "gyro", "magnetometer")
    return merged_document(
        documents, "sections", lambda one: order.index(one[SECTION]), lambda one: f"the {one[SECTION]}", _NEXT
    )


def coefficients_schema() -> dict[str, Any]:
    """Return the JSON Schema of imu_coefficients.json, made from the same declarations that check it."""
    return schema_of(ImuCoefficients)


def header_text(document: Document) -> str:
    """Return the header of a checked document; the same document gives the same bytes.

    Numbers are the shortest text that gives the same double back.
    """
    sections = {section["section"]: section for section in document["sections"]}
    present = {name: int(name in sections) for name in ("accelerometer", "gyro", "magnetometer")}
    parts = [_TYPE.format(**present)]
    for name, operator in (("accelerometer", "+"), ("gyro", "-")):
        if name in sections:
            parts.append(_triad(sections[name], operator, document["signs"][name]))
    if "magnetometer" in sections:
        parts.append(_magnetometer(sections["magnetometer"], document["signs"]["magnetometer"]))
    return c_header(document, "IMU_COEFFICIENTS", "IMU", parts)


def _triad(section: Document, operator: str, sign: str) -> str:
    rows = ", ".join(_vector(row) for row in section["matrix"])
    return _TRIAD.format(
        name=f"IMU_{section['section'].upper()}",
        matrix=f"{{ {rows} }}",
        bias=_vector(section["bias"]),
        unit=section["unit"],
        valid=_vector(section["valid_degC"]),
        function=f"imu_compensate_{section['section']}",
        operator=operator,
        sign=sign,
    )


def _magnetometer(section: Document, sign: str) -> str:
    angle = math.radians(section["alpha_deg"])
    return _MAGNETOMETER.format(
        offset=_vector(section["offset"]),
        gain=repr(float(section["gain"])),
        sine=repr(math.sin(angle)),
        cosine=repr(math.cos(angle)),
        valid=_vector(section["valid_degC"]),
        sign=sign,
    )


def _vector(values: Sequence[float]) -> str:
    return "{ " + ", ".join(repr(float(value)) for value in values) + " }"
