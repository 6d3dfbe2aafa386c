"""``bench plan``: the shortest sequence that reaches an uncertainty, or the best one in a time."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from bench.commands.check import checked_plan
from bench.commands.console import console, print_json
from bench.commands.requests import PlanRequest
from bench.model.errors import InputError, InputErrors
from bench.model.units import parse_quantity
from bench.model.yamlio import NAME_PATTERN
from bench.plan import Plan, check_plan, compile_sequence
from bench.session.designed import Asked, Proposal, curve, proposed
from bench.session.output import write_file, writing

_EXAMPLES = {"--within": "'26 h'", "--lag": "'27 min'"}
_FACTORS = (1.0, 1.25, 1.6, 2.0, 3.0)  # of the targets, for the figure


def plan(request: PlanRequest) -> None:
    """Find a plan, check it as it will be written, write it, and print what it gains and loses.

    Raises: InputError B-DES-...; InputErrors if what is written does not compile.
    """
    given = checked_plan(request.sequence, request.station)
    within_s, lag_s = _seconds("--within", request.within), _seconds("--lag", request.lag)
    name = _name(request.out, given)
    found = proposed(given, Asked(request.targets or [], within_s, lag_s))
    text = found.text(name)
    _check(found, text, request.out)
    if request.plot is not None:
        from bench.report import plots  # matplotlib takes longer to load than a sequence to check

        with writing(request.plot):
            plots.plot_trade(found.plan.name, curve(found, _FACTORS), found.today_s / 3600.0, request.plot)
    if request.out is not None:
        write_file(request.out, text)
    if request.json:
        print_json(found.document())
    else:
        out = console()
        out.print(f"{given.name}: {given.title}")
        for line in found.lines():
            out.print(f"  {line}")
        if request.out is not None:
            out.print(f"  written      {request.out}")


def _seconds(option: str, text: str | None) -> float | None:
    """Return a time of the command line. Raises: InputError B-DES-001."""
    if text is None:
        return None
    example = f"for example {_EXAMPLES[option]}"
    try:
        seconds = parse_quantity(text, "s")
    except ValueError as error:
        raise InputError("B-DES-001", str(error), where=option, next_step=example) from error
    if seconds <= 0:
        raise InputError("B-DES-001", f"{text!r} is not above zero", where=option, next_step=example)
    return seconds


def _name(out: Path | None, given: Plan) -> str:
    """Return the name of what will be written. Raises: InputError B-DES-001 for no name, or a file that was given."""
    name = out.stem if out is not None else f"{given.name}_planned"[:40]
    if not re.fullmatch(NAME_PATTERN, name):
        message, step = f"{name!r} is no name of a sequence", "small letters, digits and _, for example short.yaml"
        raise InputError("B-DES-001", message, where="--out", next_step=step)
    if out is not None and out.resolve() in {Path(file).resolve() for file in given.files.values()}:
        message = f"{out} is what the plan is made from"
        raise InputError("B-DES-001", message, where="--out", next_step="write it to another file")
    return name


def _check(found: Proposal, text: str, out: Path | None) -> None:
    """Compile a text in the folder where it will stand, since the files that it names are looked for from there.

    Raises: InputErrors for its mistakes; InputError B-DES-007 if it is not what was found, B-CLI-007.
    """
    folder, target = (None, Path(tempfile.gettempdir())) if out is None else (out.parent, out)
    with writing(target), tempfile.NamedTemporaryFile(suffix=".yaml", dir=folder, delete=False) as file:
        try:
            file.write(text.encode())
            file.close()  # not every system opens a file twice
            written = compile_sequence(file.name, found.plan.station)
        finally:
            Path(file.name).unlink(missing_ok=True)
    if mistakes := check_plan(written, written.station):
        raise InputErrors(mistakes)
    found.require_same(written)
