"""Static check of what the analysis will ask of the records: it asks only when the campaign is over.

The analyses themselves live floors above; a test holds these names to theirs.
"""

from __future__ import annotations

from difflib import get_close_matches

from bench.model.yamlio import Document
from bench.plan.findings import Findings, suggestion
from bench.plan.language import Sequence
from bench.plan.plan import Plan, Step

NONE = "none"
OF_LOGS = (
    "temperature_ramp",
    "imu_six_position",
    "imu_multi_position",
    "imu_strapdown",
)  # made of imported logs, not of records
OF_TESTS = "gnc_unit_test"  # made of commands to the unit and their answers
POSE = ("item", "mounting", "outer_deg", "middle_deg", "inner_deg")
OF_SAMPLES = {
    "imu_calibration": POSE, "imu_bias": POSE, "magnetometer": (*POSE, "rate_deg_s"),
    "fog_north": ("item", "head_deg", "index", "repeat", "rate_deg_s"),
    "rlg_lock_in": ("path_length_m", "clock_Hz"),
    "time_sync": ("item", "manoeuvre"),
}  # fmt: skip
BESIDE = {"time_sync": "egi"}  # link whose samples the analysis needs beside those that are recorded
ITEMS = ("supply", "identify", "cpu", "timer", "memory", "imu", "gps", "ad", "io", "spi", "sci", "can")
BRANCHES = ("hold_start", "up", "hold_top", "down", "hold_end")
_POINT = ("channel", "temperature_degC", "current_A", "polarity", "range_A")
ASKED = {
    "scale_factor": _POINT, "dmm_method": _POINT, "bias_ramp": ("route", "branch"), OF_TESTS: (), **OF_SAMPLES,
}  # fmt: skip
ASKED_OF_OPEN = ("channel", "temperature_degC", "route", "branch")  # an open input needs no level, polarity or range
METER = "measure_current"
OF_READINGS: set[str] = set()  # analyses of records that are made of readings of instruments


def check_named(document: Document[Sequence], findings: Findings) -> None:
    """Note an analysis that does not exist or is not made of records (B-PLAN-077)."""
    name = document.model.analysis
    if name not in (NONE, *ASKED):
        where = document.where(("analysis",))
        if name in OF_LOGS:
            message = f"the analysis {name!r} is made of imported logs, not of records"
        else:
            message = f"there is no analysis {name!r}{suggestion(name, (NONE, *ASKED))}"
        findings.add("B-PLAN-077", where, message, f"write one of: {', '.join((*ASKED, NONE))}")


def check_asked(plan: Plan, findings: Findings) -> None:
    """Note what an analysis would leave out or take for something else (B-PLAN-078)."""
    name = str(plan.campaign.get("analysis", NONE))
    records = [step for step in plan.phase("campaign") if step.kind == "record"]
    for step in records if name in ASKED else ():
        if step.conditions.get("purpose", "measurement") == "measurement":
            _check_conditions(name, step, findings)
    read = any(step.kind == "call" and step.name == METER for step in plan.phase("campaign"))
    if name == "dmm_method" and records and not read:
        message = f"the analysis {name} needs readings of the meter, and no step calls {METER}"
        findings.add("B-PLAN-078", records[0].where, message, "read the meter before each record with a closed route")

    if name in ASKED and name not in OF_READINGS and not plan.frames:
        message = f"the analysis {name} is made of frames of a unit, and the sequence names no link"
        findings.add("B-PLAN-078", plan.steps[0].where, message, "name the link under 'frame', or another analysis")
    if name == OF_TESTS and not any(step.kind == "unit" and "item" in step.arguments for step in plan.steps):
        message = f"the analysis {name} is made of 'test' steps, and there is none"
        findings.add("B-PLAN-078", plan.steps[0].where, message, "add 'test' steps; docs/gnc-module.md describes them")
    for step in plan.steps if name == OF_TESTS else ():
        _check_item(step, findings)
    if name in ASKED and name != OF_TESTS and not records:
        message = f"the analysis {name} is made of records, and there is none"
        findings.add("B-PLAN-078", plan.steps[0].where, message, "add 'record' steps, or name another analysis")
    for step in records if name in OF_SAMPLES else ():
        if not step.arguments.get("samples"):
            message = f"the analysis {name} needs the samples of each record"
            findings.add("B-PLAN-078", step.where, message, "write 'samples: true'")
    if name in BESIDE and records and BESIDE[name] not in {*plan.frames} - {plan.measurement_link}:
        message = f"the analysis {name} needs the link {BESIDE[name]!r} beside the one that is recorded, the first one"
        findings.add("B-PLAN-078", records[0].where, message, "name both links in 'frame', the recorded one first")


def _check_item(step: Step, findings: Findings) -> None:
    """An item of another name is reported and not judged: one that is nearly known is a slip of the pen."""
    item = str(step.arguments.get("item", ITEMS[0]))
    if step.kind == "unit" and item not in ITEMS and get_close_matches(item, ITEMS, n=1):
        message = f"the analysis {OF_TESTS} does not judge the item {item!r}{suggestion(item, ITEMS)}"
        findings.add("B-PLAN-078", step.where, message, "use that name, or one that is not nearly the same")


def _check_conditions(name: str, step: Step, findings: Findings) -> None:
    of_open = name not in OF_SAMPLES and step.conditions.get("route") == "open"
    asked = [one for one in ASKED[name] if one in ASKED_OF_OPEN or not of_open]
    branch = step.conditions.get("branch", "up")
    if missing := [one for one in asked if one not in step.conditions]:
        message = f"the analysis {name} asks for the condition {', '.join(missing)}, which the record does not have"
        findings.add("B-PLAN-078", step.where, message, "docs/sequences.md says what each analysis asks for")
    elif name == "bias_ramp" and branch not in BRANCHES:
        message = f"the analysis {name} knows no branch {branch!r}{suggestion(str(branch), BRANCHES)}"
        findings.add("B-PLAN-078", step.where, message, f"write one of: {', '.join(BRANCHES)}")
    elif name == "bias_ramp" and (step.conditions["route"] != "open" or "channel" in step.conditions):
        message = f"the analysis {name} asks for an open input and for all channels at once"
        findings.add("B-PLAN-078", step.where, message, "write 'route: open' and no channel")
