"""coefficients.json: what a navigation unit needs to compensate its converters, from the campaigns of one unit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from bench.analysis.analysis import Analysis
from bench.model.errors import InputError
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.group_fit import QUANTITIES, Fitted

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


class _Closed(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Parameter(_Closed):
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


class Nominal(_Closed):
    """Nominal constants the errors refer to; ``k0_C``: coulomb per pulse."""

    channel: Annotated[int, Field(ge=1)]
    kind: str
    k0_C: Annotated[float, Field(gt=0)]


class Source(_Closed):
    """A session the coefficients come from, with the worst verdict in it."""

    session: str
    campaign: str
    method: str
    session_sha256: str
    software: str
    worst_verdict: Literal["pass", "fail", "conditional_pass", "conditional_fail", "none"]
    missing: list[str]


class UnitUnderTest(_Closed):
    """The unit the coefficients belong to."""

    model: str
    serial: str


class Coefficients(_Closed):
    """The document coefficients.json."""

    schema_version: Literal[1] = Field(alias="schema")
    uut: UnitUnderTest
    simulated: bool
    signs: dict[str, str]
    nominal: list[Nominal]
    parameters: list[Parameter]
    sources: list[Source]


def scale_factor_compensation(fitted: Fitted, campaign: Campaign) -> list[dict[str, Any]]:
    """``Analysis.compensation`` of a scale-factor campaign: dsf_n, dsf_p of each channel; its bias is diagnostic."""
    found = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        warmth = [one.fit.unit_temperature_degC for one in fitted.visits(channel)]
        if quantity in QUANTITIES:
            found.append(
                {
                    "channel": channel,
                    "kind": campaign.channel(channel).kind,
                    "parameter": quantity,
                    "unit": UNITS[quantity],
                    "reference_temperature_degC": polynomial.reference_degC,
                    "coefficients": [float(one) for one in polynomial.coefficients],
                    "valid_degC": [min(warmth), max(warmth)],
                }
            )
    return found


def coefficients_of(analysis: Analysis, results: Mapping[str, Any], campaign: Mapping[str, Any]) -> dict[str, Any]:
    """The document of one session.

    Args:    analysis, results: of the session; ``campaign``: that section of its manifest.
    Raises:  InputError B-COEF-004 for a bias that is not of the bias campaign, B-COEF-006 for an entry that is not in
             the form of coefficients.json.
    """
    session = str(results["session"])
    parameters = [dict(one) | {"session": session} for one in analysis.compensation]
    if analysis.campaign != BIAS_CAMPAIGN and any(one["parameter"] == "bias" for one in parameters):
        raise InputError(
            "B-COEF-004",
            f"the bias of a campaign {analysis.campaign!r} is diagnostic; only that of {BIAS_CAMPAIGN!r} compensates",
            where=session,
            next_step=_NEXT,
        )
    channels = campaign.get("channels", ())
    document = {
        "schema": 1,
        "uut": {name: str(results["uut"][name]) for name in ("model", "serial")},
        "simulated": results["provenance"]["simulated"] is not False,
        "signs": dict(SIGNS),
        "nominal": [{"channel": one["number"], "kind": one["kind"], "k0_C": one["k0_C"]} for one in channels],
        "parameters": parameters,
        "sources": [source_of(analysis, results)],
    }
    validate_coefficients(document, session)
    return document


def source_of(analysis: Analysis, results: Mapping[str, Any]) -> dict[str, Any]:
    """Where coefficients come from: session, method, hashes, the worst verdict and what is missing."""
    return {
        "session": str(results["session"]),
        "campaign": analysis.campaign,
        "method": analysis.method,
        "session_sha256": results["provenance"]["session_sha256"],
        "software": results["provenance"]["software"],
        "worst_verdict": _worst(one["verdict"] for one in results["estimates"]),
        "missing": list(analysis.missing),
    }


def merged(documents: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """One document of the sessions of one unit, parameters by name and channel.

    A campaign may measure some channels only; those that several measure must have the same nominal constants.
    Raises: InputError B-COEF-001 (another unit, or other nominal constants), B-COEF-002 (a parameter twice),
            B-COEF-003 (simulated and real).
    """
    first = documents[0]
    same_unit(documents)
    parameters = [one for document in documents for one in document["parameters"]]
    seen: dict[tuple[str, int], str] = {}
    for one in parameters:
        place = one["parameter"], one["channel"] or 0
        if place in seen:
            raise InputError(
                "B-COEF-002",
                f"{place[0]} of {f'channel {place[1]}' if place[1] else 'the unit'} comes from two sessions",
                where=f"{seen[place]}, {one['session']}",
                next_step=_NEXT,
            )
        seen[place] = one["session"]
    order = list(UNITS)
    return dict(first) | {
        "nominal": _nominal(documents),
        "parameters": sorted(parameters, key=lambda one: (order.index(one["parameter"]), one["channel"] or 0)),
        "sources": [source for document in documents for source in document["sources"]],
    }


def same_unit(documents: Sequence[Mapping[str, Any]]) -> None:
    """Refuse documents that do not belong together.

    Raises: InputError B-COEF-001 (another unit), B-COEF-003 (simulated and real).
    """
    for other in documents[1:]:
        _same(documents[0], other, "uut", "B-COEF-001", "belong to different units")
        _same(documents[0], other, "simulated", "B-COEF-003", "are partly simulated, partly measured")


def _same(first: Mapping[str, Any], other: Mapping[str, Any], name: str, code: str, what: str) -> None:
    if first[name] != other[name]:
        places = ", ".join(str(one["sources"][0]["session"]) for one in (first, other))
        both = f"{_words(first[name])} and {_words(other[name])}"
        raise InputError(code, f"the sessions {what} ({both})", where=places, next_step=_NEXT)


def _nominal(documents: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    found: dict[int, tuple[dict[str, Any], str]] = {}
    for document in documents:
        session = str(document["sources"][0]["session"])
        for one in document["nominal"]:
            known, where = found.setdefault(one["channel"], (dict(one), session))
            if known != one:
                values = " and ".join(f"{each['kind']} {each['k0_C']} C" for each in (known, one))
                message = f"the sessions refer to different nominal constants of channel {one['channel']} ({values})"
                raise InputError("B-COEF-001", message, where=f"{where}, {session}", next_step=_NEXT)
    return [found[number][0] for number in sorted(found)]


def _words(value: Any) -> str:
    return " ".join(value.values()) if isinstance(value, Mapping) else ("simulated" if value else "measured")


def _worst(verdicts: Iterable[str]) -> str:
    found = set(verdicts)
    return next((one for one in ("fail", "conditional_fail", "conditional_pass", "pass") if one in found), "none")


def validate_coefficients(document: object, where: str, form: type[BaseModel] = Coefficients) -> None:
    """Check a document against its form. Raises InputError B-COEF-006 naming the first wrong field."""
    try:
        form.model_validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(
            "B-COEF-006",
            f"{place}: {first['msg'][:1].lower()}{first['msg'][1:]} (found {str(first['input'])[:60]})",
            where=where,
            next_step="correct the analysis that makes these coefficients",
        ) from error


def coefficients_schema() -> dict[str, Any]:
    """JSON Schema of coefficients.json, made from the same declarations that check it."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Coefficients.model_json_schema(by_alias=True)}
