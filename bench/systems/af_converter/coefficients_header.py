"""coefficients.json as a C99 header that a navigation engineer can paste."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from bench.analysis import c_preamble, c_text

_NAMES = {"dsf_n": "DSF_N_PPM", "dsf_p": "DSF_P_PPM", "bias": "BIAS_A", "master_clock": "MASTER_CLOCK_PPM"}

_TYPE = """\
/* coefficient[k] in the unit of the name per degC^k; T: the temperature that the unit's own sensor reads. */
typedef struct {
    double reference_degC;
    double valid_low_degC;
    double valid_high_degC;
    int count; /* of coefficients; 0: the channel has none */
    double coefficient[WIDTH];
} compensation_polynomial;

/* Value at T. Returns 0; or 1 where T is outside of the measured range, the value then being an extrapolation;
   or -1 where there are no coefficients, the value then being 0. */
static inline int compensation_value(const compensation_polynomial *polynomial, double temperature_degC, double *value)
{
    const double step = temperature_degC - polynomial->reference_degC;
    int k;
    *value = 0.0;
    for (k = polynomial->count - 1; k >= 0; --k) {
        *value = *value * step + polynomial->coefficient[k];
    }
    if (polynomial->count == 0) {
        return -1;
    }
    return temperature_degC < polynomial->valid_low_degC || temperature_degC > polynomial->valid_high_degC;
}
"""


def header_text(document: Mapping[str, Any]) -> str:
    """Return the header of a checked document; the same document gives the same bytes.

    Tables are indexed by channel number, 0 unused, all of one length: no channel that is in one of them lies outside
    of another. Numbers are the shortest text that gives the same double back.
    """
    unit = document["uut"]
    guard = re.sub("[^A-Z0-9]+", "_", f"COMPENSATION_{unit['model']}_{unit['serial']}_H".upper())
    parameters = document["parameters"]
    width = max((len(one["coefficients"]) for one in parameters), default=1)
    last = max((int(one["channel"] or 0) for one in (*document["nominal"], *parameters)), default=0)
    parts = [
        c_preamble(document),
        f"#ifndef {guard}\n#define {guard}\n",
        f"#define COMPENSATION_SIMULATED {int(document['simulated'])}\n",
        _TYPE.replace("WIDTH", str(width)),
        _nominal(document["nominal"], last),
    ]
    for name, constant in _NAMES.items():
        members = [one for one in parameters if one["parameter"] == name]
        if members:
            parts.append(_table(f"COMPENSATION_{constant}", members, width, last))
    return "\n".join([*parts, f"#endif /* {guard} */\n"])


def _nominal(nominal: Sequence[Mapping[str, Any]], last: int) -> str:
    if not nominal:
        return ""
    charges = {int(one["channel"]): one for one in nominal}
    lines = [
        f"    {float(charges[number]['k0_C'])!r}, /* {number}: {c_text(charges[number]['kind'])} */"
        if number in charges
        else f"    0.0, /* {number}: none */"
        for number in range(last + 1)
    ]
    head = [
        "/* Nominal charge per pulse, coulomb, by channel. */",
        f"static const double COMPENSATION_K0_C[{len(lines)}] = {{",
    ]
    return "\n".join([*head, *lines, "};\n"])


def _table(name: str, members: Sequence[Mapping[str, Any]], width: int, last: int) -> str:
    if members[0]["channel"] is None:
        return f"static const compensation_polynomial {name} = {_initialiser(members[0], width)};\n"
    by_channel = {int(one["channel"]): one for one in members}
    lines = [
        f"    {_initialiser(by_channel.get(number), width)}, /* {number}{'' if number in by_channel else ': none'} */"
        for number in range(last + 1)
    ]
    return f"static const compensation_polynomial {name}[{len(lines)}] = {{\n" + "\n".join(lines) + "\n};\n"


def _initialiser(one: Mapping[str, Any] | None, width: int) -> str:
    coefficients = [] if one is None else [float(value) for value in one["coefficients"]]
    numbers = ", ".join(repr(value) for value in [*coefficients, *[0.0] * (width - len(coefficients))])
    low, high = (0.0, 0.0) if one is None else one["valid_degC"]
    reference = 0.0 if one is None else float(one["reference_temperature_degC"])
    return f"{{ {reference!r}, {float(low)!r}, {float(high)!r}, {len(coefficients)}, {{ {numbers} }} }}"
