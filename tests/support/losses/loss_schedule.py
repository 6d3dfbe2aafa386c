"""Losses of instruments, drawn by seed: what is lost, how, at which moment of a run, and for how long. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

STIMULUS = ("calibrator", "switch")  # drives the unit, leads the current to it
ALL = "all"
WEIGHTS = {"calibrator": 6, "switch": 4, "supply": 3, ALL: 6}  # every other role: 1
Kind = Literal["none", "refused", "reset", "cut", "mute", "down", "server"]
KINDS: tuple[Kind, ...] = ("refused", "reset", "cut", "mute", "down", "server")
FEW_SERVERS = 3 * KINDS[:-1] + KINDS[-1:]  # a bench that was begun anew takes a person twice: slow
HOLDING, CLOSING = "holding", "closing"
MOMENTS = ("prompt", "call", "call", "settle", "record", "verify", "unit", "soak", HOLDING, CLOSING)
OWN_STEP = 0.7  # share of calls and checks that are of the lost instrument itself, where it has any
LATE_S = 0.1  # of a call: the latest moment behind its begin
CLOSES_S = 0.8  # in which a run makes its bench safe and says goodbye


@dataclass(frozen=True)
class Scale:
    """How long losses last (second; infinite: for good), how long one for good is watched, how long the judge looks.

    Args: short: the sequence is cut down to one temperature.
    """

    name: str
    lengths_s: tuple[float, ...]
    good_s: float
    look_s: float = 6.0  # behind a loss, before a person comes: more than the 5 s in which all must be off
    stuck_s: float = 20.0  # a person waits so long for a run that still holds then, ends it and goes on with it
    short: bool = False


SHORT = Scale("short", (2.0, 6.5, 8.0, math.inf), 10.0, stuck_s=6.0, short=True)
SCALED = Scale("scaled", (3.0, 8.0, 20.0, 45.0, math.inf), 40.0)
FULL = Scale("full", (30.0, 90.0, 300.0, math.inf), 120.0)
SCALES = {scale.name: scale for scale in (SHORT, SCALED, FULL)}
FULL_EVERY = 5  # seeds of the whole drill: each fifth one at full length


@dataclass(frozen=True)
class PlanStep:
    """Number, kind, role and planned length (second) of a step of the plan."""

    number: int
    kind: str
    role: str
    duration_s: float


@dataclass(frozen=True)
class Loss:
    """One loss. ``step``: it is due at its begin, ``delay_s`` later; ``length_s`` is 0 where it is over at once."""

    seed: int
    target: str
    kind: Kind
    moment: str
    step: int
    delay_s: float
    length_s: float


def scale_of(seed: int) -> Scale:
    """Return the scale of a seed of the whole drill."""
    return FULL if seed % FULL_EVERY == 0 else SCALED


def drawn(
    seed: int, steps: Sequence[PlanStep], scale: Scale, roles: Sequence[str], kinds: Sequence[Kind],
    part: tuple[int, int] = (0, 1),
) -> Loss:  # fmt: skip
    """Draw the loss of a seed; all kinds come in turn, so that few seeds have each of them.

    Args: roles: of the instruments.   kinds: that this machine can do.   part: number, and of how many, of the parts of
    the plan: losses of one run do not come at once.
    """
    rng = np.random.default_rng((seed, len(scale.name)))
    kind = kinds[(seed + 2 * (seed // FULL_EVERY)) % len(kinds)]
    names = [*roles, ALL]
    weights = np.array([WEIGHTS.get(name, 1) for name in names], dtype=float)
    target = ALL if kind == "server" else names[int(rng.choice(len(names), p=weights / weights.sum()))]
    number, parts = part
    steps = steps[number * len(steps) // parts : (number + 1) * len(steps) // parts]
    there = {step.kind for step in steps} | {HOLDING} | ({CLOSING} if number == parts - 1 else set())
    moments = [moment for moment in MOMENTS if moment in there]
    moment = moments[int(rng.integers(len(moments)))]
    step = _step_of(moment, target, steps, rng)
    longest_s = {CLOSING: CLOSES_S, "call": LATE_S, "verify": LATE_S}.get(moment, step.duration_s)
    length_s = 0.0 if kind == "cut" else scale.lengths_s[int(rng.integers(len(scale.lengths_s)))]
    return Loss(seed, target, kind, moment, step.number, float(rng.uniform(0.0, longest_s)), length_s)


def _step_of(moment: str, target: str, steps: Sequence[PlanStep], rng: np.random.Generator) -> PlanStep:
    if moment == CLOSING:
        return steps[-1]
    waits = ("settle", "record")  # at which a run is held
    found = [step for step in steps if (step.kind in waits if moment == HOLDING else step.kind == moment)]
    own = [step for step in found if step.role == target]
    if own and rng.random() < OWN_STEP:
        found = own
    return found[int(rng.integers(len(found)))]
