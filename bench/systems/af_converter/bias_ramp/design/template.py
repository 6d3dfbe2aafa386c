"""What a given bias ramp does, what any other between the same temperatures would do, and how it is written."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from bench.analysis import Floats
from bench.design import SequenceText
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from bench.plan import MEASUREMENT, LAB_AIR_degC, Plan, PlannedCall, PlannedRecord, PlannedSoak

BRANCHES = ("hold_start", "up", "hold_top", "down", "hold_end")
HOLDS = BRANCHES[::2]
_MINUTE_s = 60.0
_WINDOWS = re.compile(r"\bwindows: *[^,}\s]+")
_RAMP = re.compile(r'\bramp: *("[^"]*"|[^,}]+)')
_FORM = "a soak to one end, then windows of one length without a gap: " + ", ".join(BRANCHES)


@dataclass(frozen=True)
class Template:
    """``rates``: of the ramps up and down, 0.01 degC/min.   ``holds``: windows of each.   ``ends_degC``: cold, hot.

    ``window``: the first of all; ``timed``: whether pulses are timed.   ``soak``: that of the preparation.
    """

    rates: tuple[int, int]
    holds: tuple[int, int, int]
    ends_degC: tuple[float, float]
    window: RecordWindow
    timed: bool
    soak: PlannedSoak

    @property
    def window_s(self) -> float:
        """Length of a window, second."""
        return (self.window.t_end_ns - self.window.t_start_ns) / NS

    def ramps_s(self, rates: tuple[int, int]) -> tuple[float, float]:
        """Return how long the air takes up and down, second."""
        span_degC = self.ends_degC[1] - self.ends_degC[0]
        return 6000.0 * span_degC / rates[0], 6000.0 * span_degC / rates[1]

    def counts(self, rates: tuple[int, int], holds: tuple[int, int, int]) -> dict[str, int]:
        """Return the windows of each branch: a ramp ends inside the last of its own."""
        up, down = (math.ceil(ramp_s / self.window_s - 1e-9) for ramp_s in self.ramps_s(rates))
        return dict(zip(BRANCHES, (holds[0], up, holds[1], down, holds[2]), strict=True))

    def windows(self, counts: Mapping[str, int]) -> list[RecordWindow]:
        """Return the windows of a ramp, by number."""
        first = self.window
        windows: list[RecordWindow] = []
        length_ns = first.t_end_ns - first.t_start_ns
        for branch, count in counts.items():
            for _ in range(count):
                done = len(windows)
                windows.append(
                    replace(
                        first,
                        number=done + 1,
                        first_counter=first.first_counter + done * first.frames,
                        t_start_ns=first.t_start_ns + done * length_ns,
                        t_end_ns=first.t_end_ns + done * length_ns,
                        conditions={**first.conditions, "branch": branch},
                    )
                )
        return windows

    def air(self, rates: tuple[int, int], holds: tuple[int, int, int]) -> tuple[Floats, Floats]:
        """Return times and temperatures of the planned air, the preparation included, once a minute and at corners."""
        cold, hot = self.ends_degC
        up_s, down_s = self.ramps_s(rates)
        counts = list(self.counts(rates, holds).values())
        begins_s = [self.window.t_start_ns / NS + self.window_s * done for done in accumulate(counts, initial=0)]
        soaked_s = self.soak.at_s + 60.0 * abs(cold - LAB_AIR_degC) / self.soak.ramp_degC_min
        corners_s = [
            self.soak.at_s, soaked_s, begins_s[1], begins_s[1] + up_s, begins_s[3], begins_s[3] + down_s, begins_s[5],
        ]  # fmt: skip
        t_s = np.union1d(np.arange(corners_s[0], corners_s[-1], _MINUTE_s), corners_s)
        return t_s, np.interp(t_s, corners_s, [LAB_AIR_degC, cold, cold, hot, hot, cold, cold])


def template_of(plan: Plan) -> Template:
    """Read the parts of a ramp from its plan. Raises: InputError B-DES-005 for one of another form."""
    steps = plan.phase("campaign")
    records = [step for step in steps if isinstance(step, PlannedRecord)]
    points = [step.set_point for step in steps if isinstance(step, PlannedCall) and step.set_point is not None]
    soaks = [step for step in plan.phase("prepare") if isinstance(step, PlannedSoak)]
    branches = [str(step.conditions.get("branch")) for step in records]
    if list(dict.fromkeys(branches)) != list(BRANCHES) or branches != sorted(branches, key=BRANCHES.index):
        raise _other_form(plan, "branches missing or in another order")
    measuring = all(step.purpose == MEASUREMENT for step in records)
    if len(points) != 2 or len(soaks) != 1 or len({step.seconds for step in records}) != 1 or not measuring:
        raise _other_form(plan, "another number of ramps or soaks, or windows of several lengths")
    cold, hot = soaks[0].temperature_degC, points[0].temperature_degC
    first, begin_s = records[0], plan.prepare_s
    rate_Hz = float(plan.campaign["rate_Hz"])
    template = Template(
        rates=(round(100.0 * points[0].ramp_degC_min), round(100.0 * points[1].ramp_degC_min)),
        holds=(branches.count(HOLDS[0]), branches.count(HOLDS[1]), branches.count(HOLDS[2])),
        ends_degC=(cold, hot),
        window=RecordWindow(
            number=1, link=plan.measurement_link, first_counter=round(begin_s * rate_Hz),
            frames=round(first.seconds * rate_Hz), t_start_ns=round(begin_s * NS),
            t_end_ns=round((begin_s + first.seconds) * NS), conditions=first.conditions,
        ),
        timed=first.pulse_timing,
        soak=soaks[0],
    )  # fmt: skip
    counts = template.counts(template.rates, template.holds)
    if hot <= cold or points[1].temperature_degC != cold or counts != {name: branches.count(name) for name in BRANCHES}:
        raise _other_form(plan, "ramps are not up and down again, as long as their branches")
    return template


def write_steps(text: SequenceText, template: Template, rates: tuple[int, int], holds: tuple[int, int, int]) -> None:
    """Write the steps with other windows and ramps. Raises: InputError B-DES-005 for another form."""
    lines = list(_step_lines(text, template, rates, holds))
    if "ramp" in text.tree.get("parameters", {}) and text.count("{ramp}") == len(rates):
        text.remove(("parameters", "ramp"))
    text.replace_below(("steps",), lines)


def _step_lines(
    text: SequenceText, template: Template, rates: Sequence[int], holds: tuple[int, int, int]
) -> Iterator[str]:
    counts = template.counts((rates[0], rates[1]), holds)
    before = template.counts(template.rates, template.holds)
    branches, ramps = list(BRANCHES), [f"ramp: {rate / 100.0:g} degC/min" for rate in rates]
    for number in range(len(text.tree["steps"])):
        block = "\n".join(text.block(("steps", number)))
        if _WINDOWS.search(block) and branches:
            branch = branches.pop(0)
            yield f"  # {branch}: {counts[branch]} windows, {before[branch]} before"
            block = _WINDOWS.sub(f"windows: {counts[branch]}", block)
        elif _RAMP.search(block) and ramps:
            block = _RAMP.sub(ramps.pop(0), block)
        yield from block.splitlines()
    if branches or ramps:
        message = f"the ramp cannot be written in the place of this one, which is not of the form: {_FORM}"
        raise InputError(
            "B-DES-005", message, where=text.where(("steps",)), next_step="begin with the shipped bias_ramp_25h"
        )


def _other_form(plan: Plan, why: str) -> InputError:
    message = f"a shorter ramp is made of {_FORM}; {plan.name} is not ({why})"
    return InputError("B-DES-005", message, where=plan.name, next_step="begin with the shipped bias_ramp_25h")
