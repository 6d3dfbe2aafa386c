"""``bench recover``: what a session still holds, which of its records are valid, and a sequence for the rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.commands.console import print_json, say
from bench.model.errors import BenchError, ExitStatus, InputError, InputErrors
from bench.model.units import hours
from bench.plan import Plan, check_plan, compile_sequence, frozen_plan
from bench.record import SessionReader, Survey, recover_session
from bench.replay import replay_rows
from bench.session.makeup import make_up_sequence
from bench.session.output import write_file
from bench.session.record_states import RecordState, record_states, summary_lines


def recover(session: Path, make_up: Path | None, as_json: bool) -> int:
    """List damage, what is whole, and the state of every record; exit status 5 when anything is damaged.

    Raises: InputError B-REC-010; with ``make_up`` what bench.session.makeup raises, B-RES-003, B-RES-004, B-RES-009.
    """
    survey = recover_session(session)
    try:
        plan, states = _states(session)
    except BenchError as error:
        if make_up is not None:
            raise
        plan, states, trouble = None, [], [str(error)]
    else:
        trouble = []
    written = [] if make_up is None or plan is None else [_written(plan, states, make_up)]
    _tell(survey, states, [*trouble, *written], as_json)
    return ExitStatus.SESSION_DAMAGED if survey.damaged else ExitStatus.PASS


def _states(session: Path) -> tuple[Plan, list[RecordState]]:
    reader = SessionReader(session)
    plan = frozen_plan(session, reader.manifest, reader.texts)
    return plan, record_states(plan.steps, replay_rows(session))


def _tell(survey: Survey, states: list[RecordState], more: list[str], as_json: bool) -> None:
    if as_json:
        document: dict[str, Any] = {**survey.as_json(), "record_states": [state.as_json() for state in states]}
        print_json(document)
        return
    for line in [*survey.lines(), *(summary_lines(states) if states else []), *more]:
        say(line)


def _written(plan: Plan, states: list[RecordState], path: Path) -> str:
    """Write the make-up sequence and prove that it compiles for the session's station."""
    if path.exists():
        raise InputError("B-RES-009", "exists already", where=path, next_step="name a file that does not exist yet")
    text, points, overlap = make_up_sequence(plan, states)
    write_file(path, text)
    made = compile_sequence(path, plan.station)
    if mistakes := check_plan(made, plan.station):
        raise InputErrors(mistakes)
    return (
        f"{path}: {points} points to make up and {overlap} that overlap, {hours(made.prepare_s + made.duration_s)}; "
        f"run it, then 'bench fit SESSION --with MAKE_UP_SESSION'"
    )
