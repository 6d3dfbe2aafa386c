"""What a plan judges, and where: a line for each value that it names and each fit, as ``bench check`` prints them."""

from __future__ import annotations

from collections.abc import Iterator

from bench.analysis import Document, limits_text, number, place_of
from bench.model.units import hours
from bench.plan import Plan

_WORDS = {"": "{}", "log": "log({})", "reciprocal": "1/{}"}


def not_judged(campaign: Document) -> bool:
    """Return whether a campaign reads values and expects nothing of any of them."""
    values, fits = campaign.get("expected", ()), campaign.get("fits", ())
    read_back = [value for fit in fits for value in fit.get("read_back", ())]
    judged = any({"low", "high", "span"} & value.keys() for value in (*values, *read_back))
    judged = judged or any(fit["expected"] for fit in fits)
    return bool(values) and not judged


def judged_lines(plan: Plan) -> Iterator[str]:
    """Yield what is expected of each value, with the times of the steps that read it, and of each fit."""
    entries: dict[str, list[Document]] = {}
    for entry in plan.campaign.get("expected", ()):
        entries.setdefault(entry["quantity"], []).append(entry)
    for name, group in entries.items():
        yield f"{name}: {_expected(group)}; {_where(plan, name)}"
    for fit in plan.campaign.get("fits", ()):
        yield f"{fit['name']}: {_fit(fit)}; at the end"


def _expected(group: list[Document]) -> str:
    texts = [_limits(entry) for entry in group]
    if len({*texts}) == 1:
        return texts[0]
    first, last = group[0], group[-1]
    return f"{texts[0]}{place_of(first['conditions'])}, to {texts[-1]}{place_of(last['conditions'])}"


def _limits(entry: Document) -> str:
    if entry.get("reply", {}).get("equals") is not None:
        return f"equals {entry['reply']['equals']!r}"
    low, high = entry.get("low"), entry.get("high")
    ends = (float("-inf") if low is None else low, float("inf") if high is None else high)
    unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
    text = "reported" if low is None and high is None else f"{limits_text(ends)}{unit}"
    return text if "span" not in entry else f"{text}, stable within {number(entry['span'])}{unit}"


def _where(plan: Plan, quantity: str) -> str:
    steps = [step for step in plan.steps if quantity in step.quantities]
    if not steps:
        return "nowhere"
    more = f" and {len(steps) - 1} times more" if len(steps) > 1 else ""
    phase = "" if steps[0].phase == "campaign" else f" of '{steps[0].phase}'"
    return f"{hours(steps[0].at_s)}{phase}{more} ({steps[0].where})"


def _fit(fit: Document) -> str:
    against = fit["against"]
    x = _WORDS[against.get("function", "")].format(against.get("quantity") or against.get("condition") or "time")
    y = _WORDS[fit.get("function", "")].format(fit["of"])
    units = fit["units"]
    judged = [f"{result} {_limits({**limits, 'unit': units[result]})}" for result, limits in fit["expected"].items()]
    judged += [f"{value['quantity']} {_limits(value)}" for value in fit.get("read_back", ())]
    return f"{y} against {x}, {', '.join(judged) or 'reported'}"
