"""imu_coefficients.json as a C99 header with the functions that apply it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from bench.analysis import c_preamble

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


def header_text(document: Mapping[str, Any]) -> str:
    """Return the header of a checked document; the same document gives the same bytes.

    Numbers are the shortest text that gives the same double back.
    """
    unit = document["uut"]
    guard = re.sub("[^A-Z0-9]+", "_", f"IMU_COEFFICIENTS_{unit['model']}_{unit['serial']}_H".upper())
    sections = {section["section"]: section for section in document["sections"]}
    present = {name: int(name in sections) for name in ("accelerometer", "gyro", "magnetometer")}
    parts = [
        c_preamble(document),
        f"#ifndef {guard}\n#define {guard}\n",
        f"#define IMU_SIMULATED {int(document['simulated'])}\n",
        _TYPE.format(**present),
    ]
    for name, operator in (("accelerometer", "+"), ("gyro", "-")):
        if name in sections:
            parts.append(_triad(sections[name], operator, document["signs"][name]))
    if "magnetometer" in sections:
        parts.append(_magnetometer(sections["magnetometer"], document["signs"]["magnetometer"]))
    return "\n".join([*parts, f"#endif /* {guard} */\n"])


def _triad(section: Mapping[str, Any], operator: str, sign: str) -> str:
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


def _magnetometer(section: Mapping[str, Any], sign: str) -> str:
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
