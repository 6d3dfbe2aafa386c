"""coefficients.json: what a navigation unit needs to compensate its converters, from the campaigns of one unit; and the
same as a C99 header that a navigation engineer can paste.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from bench.analysis import (
    Analysis,
    Closed,
    CoefficientsFile,
    Document,
    Source,
    c_header,
    c_text,
    coefficients_document,
    merged_document,
    of_session,
    schema_of,
)
from bench.model.errors import InputError
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.group_fit import QUANTITIES, Fitted

NAME = "coefficients"
BIAS_CAMPAIGN = "bias_ramp"  # the bias of any other campaign is diagnostic (paper, end of section 3.3)
UNITS = {"dsf_n": "ppm", "dsf_p": "ppm", "bias": "A", "master_clock": "ppm"}
SIGNS = {
    "current": "i = k0 (1 + dsf_n 1e-6) C_N - k0 (1 + dsf_p 1e-6) C_P + bias; C = pulses / gate x clock ratio",
    "dsf_n": "scale-factor error of the positive counter; positive = more current per pulse than nominal",
    "dsf_p": "scale-factor error of the negative counter; positive = more current per pulse than nominal",
    "bias": "correction ADDED to the reading, the negative of what the open input reads (IEEE: opposite sign)",
    "master_clock": "relative frequency error of the master clock; positive = runs fast",
    "polynomial": "sum of coefficients[k] (T - reference_temperature_degC)^k, T: the unit's own temperature sensor",
}
_NEXT = "merge one scale-factor and one bias session of the same unit"
_CONSTANTS = {"dsf_n": "DSF_N_PPM", "dsf_p": "DSF_P_PPM", "bias": "BIAS_A", "master_clock": "MASTER_CLOCK_PPM"}


def per_degC(unit: str, order: int) -> str:
    """Return the unit of the coefficient of (T - T_ref)^order."""
    return unit + ("", "/degC", f"/degC{order}")[min(order, 2)]


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


class Parameter(Closed):
    """Polynomial of one parameter of one channel over temperature; channel null: of the whole unit."""

    channel: Annotated[int, Field(ge=1)] | None
    kind: str | None
    parameter: Literal["dsf_n", "dsf_p", "bias", "master_clock"]
    unit: str
    reference_temperature_degC: float
    coefficients: Annotated[list[float], Field(min_length=1)]
    valid_degC: Annotated[list[float], Field(min_length=2, max_length=2)]
    session: str

    @model_validator(mode="after")
    def _as_the_header_says(self) -> Parameter:
        if self.unit != UNITS[self.parameter]:
            raise ValueError(f"{self.parameter} in {self.unit!r}, {UNITS[self.parameter]!r} is due")
        if self.valid_degC[0] > self.valid_degC[1]:
            raise ValueError(f"valid from {self.valid_degC[0]} to {self.valid_degC[1]} degC")
        return self


class Nominal(Closed):
    """Nominal constants the errors refer to; ``k0_C``: coulomb per pulse."""

    channel: Annotated[int, Field(ge=1)]
    kind: str
    k0_C: Annotated[float, Field(gt=0)]


class Coefficients(CoefficientsFile):
    """The document coefficients.json."""

    nominal: list[Nominal]
    parameters: list[Parameter]
    sources: list[Source]


def compensation_entry(
    parameter: str,
    channel_and_kind: tuple[int | None, str | None],
    reference_degC: float,
    coefficients: Iterable[float],
    valid_degC: list[float],
) -> dict[str, Any]:
    """Return one entry of ``Analysis.compensation``; channel and kind are None for what is of the whole unit."""
    return {
        "channel": channel_and_kind[0],
        "kind": channel_and_kind[1],
        "parameter": parameter,
        "unit": UNITS[parameter],
        "reference_temperature_degC": reference_degC,
        "coefficients": [float(value) for value in coefficients],
        "valid_degC": valid_degC,
    }


def scale_factor_compensation(fitted: Fitted, campaign: Campaign) -> list[dict[str, Any]]:
    """``Analysis.compensation`` of a scale-factor campaign: dsf_n, dsf_p of each channel; its bias is diagnostic."""
    entries = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        warmth = [visit.fit.unit_temperature_degC for visit in fitted.visits(channel)]
        if quantity in QUANTITIES:
            place, valid = (channel, campaign.channel(channel).kind), [min(warmth), max(warmth)]
            entry = compensation_entry(quantity, place, polynomial.reference_degC, polynomial.coefficients, valid)
            entries.append(entry)
    return entries


def coefficients_of(analysis: Analysis, results: Document, campaign: Document) -> Document:
    """Return the document of one session.

    Args:    analysis, results: of the session; ``campaign``: that section of its manifest.
    Raises:  InputError B-COEF-004 for a bias that is not of the bias campaign, B-COEF-006 for an entry that is not in
             the form of coefficients.json.
    """
    parameters = of_session(analysis, results)
    if analysis.campaign != BIAS_CAMPAIGN and any(parameter["parameter"] == "bias" for parameter in parameters):
        raise InputError(
            "B-COEF-004",
            f"the bias of a campaign {analysis.campaign!r} is diagnostic; only that of {BIAS_CAMPAIGN!r} compensates",
            where=str(results["session"]),
            next_step=_NEXT,
        )
    nominal = [
        {"channel": channel["number"], "kind": channel["kind"], "k0_C": channel["k0_C"]}
        for channel in campaign.get("channels", ())
    ]
    return coefficients_document(Coefficients, analysis, results, SIGNS, nominal=nominal, parameters=parameters)


def merged(documents: Sequence[Document]) -> Document:
    """Return one document of the sessions of one unit, parameters by name and channel.

    A campaign may measure some channels only; those that several measure must have the same nominal constants.
    Raises: InputError B-COEF-001 (another unit, or other nominal constants), B-COEF-002 (a parameter twice),
            B-COEF-003 (simulated and real).
    """
    document = merged_document(documents, "parameters", _place, _words, _NEXT)
    return {**document, "nominal": _nominal(documents)}


def _place(parameter: Document) -> tuple[int, int]:
    return list(UNITS).index(parameter["parameter"]), parameter["channel"] or 0


def _words(parameter: Document) -> str:
    channel = parameter["channel"]
    return f"{parameter['parameter']} of {f'channel {channel}' if channel else 'the unit'}"


def _nominal(documents: Sequence[Document]) -> list[dict[str, Any]]:
    stated: dict[int, tuple[dict[str, Any], str]] = {}
    for document in documents:
        session = str(document["sources"][0]["session"])
        for constants in document["nominal"]:
            known, where = stated.setdefault(constants["channel"], (dict(constants), session))
            if known != constants:
                values = " and ".join(f"{each['kind']} {each['k0_C']} C" for each in (known, constants))
                message = (
                    f"the sessions refer to different nominal constants of channel {constants['channel']} ({values})"
                )
                raise InputError("B-COEF-001", message, where=f"{where}, {session}", next_step=_NEXT)
    return [stated[number][0] for number in sorted(stated)]


def coefficients_schema() -> dict[str, Any]:
    """Return the JSON Schema of coefficients.json, made from the same declarations that check it."""
    return schema_of(Coefficients)


def header_text(document: Document) -> str:
    """Return the header of a checked document; the same document gives the same bytes.

    Tables are indexed by channel number, 0 unused, all of one length: no channel that is in one of them lies outside
    of another. Numbers are the shortest text that gives the same double back.
    """
    parameters = document["parameters"]
    width = max((len(parameter["coefficients"]) for parameter in parameters), default=1)
    last = max((int(entry["channel"] or 0) for entry in (*document["nominal"], *parameters)), default=0)
    parts = [
        _TYPE.replace("WIDTH", str(width)),
        _nominal_charges(document["nominal"], last),
    ]
    for name, constant in _CONSTANTS.items():
        members = [parameter for parameter in parameters if parameter["parameter"] == name]
        if members:
            parts.append(_table(f"COMPENSATION_{constant}", members, width, last))
    return c_header(document, "COMPENSATION", "COMPENSATION", parts)


def _nominal_charges(nominal: Sequence[Document], last: int) -> str:
    if not nominal:
        return ""
    charges = {int(constants["channel"]): constants for constants in nominal}
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


def _table(name: str, members: Sequence[Document], width: int, last: int) -> str:
    if members[0]["channel"] is None:
        return f"static const compensation_polynomial {name} = {_initialiser(members[0], width)};\n"
    by_channel = {int(parameter["channel"]): parameter for parameter in members}
    lines = [
        f"    {_initialiser(by_channel.get(number), width)}, /* {number}{'' if number in by_channel else ': none'} */"
        for number in range(last + 1)
    ]
    return f"static const compensation_polynomial {name}[{len(lines)}] = {{\n" + "\n".join(lines) + "\n};\n"


def _initialiser(parameter: Document | None, width: int) -> str:
    coefficients = [] if parameter is None else [float(value) for value in parameter["coefficients"]]
    numbers = ", ".join(repr(value) for value in [*coefficients, *[0.0] * (width - len(coefficients))])
    low, high = (0.0, 0.0) if parameter is None else parameter["valid_degC"]
    reference = 0.0 if parameter is None else float(parameter["reference_temperature_degC"])
    return f"{{ {reference!r}, {float(low)!r}, {float(high)!r}, {len(coefficients)}, {{ {numbers} }} }}"
