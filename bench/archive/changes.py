"""What a trial would change: quantities in units of their released uncertainty, verdicts, certificates.

Nothing is decided here. Whether a certificate is recalled is decided by people.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np

from bench.archive.evidence import Evidence
from bench.maths.verdict import verdict_words
from bench.report import grouped
from bench.store import StoredTrial

Row = Mapping[str, Any]
# In another environment floats agree to this, and no better: less is no change (docs/report.md).
REL_TOL = 1e-9
_SHARES = (0.0, 5.0, 50.0, 95.0, 100.0)  # percentiles


@dataclass(frozen=True)
class QuantityChange:
    """(New - released) / U released of all estimates of one quantity: percentiles 0, 5, 50, 95, 100, or ().

    ``changed``: how many are not the same to 1e-9; ``above_one``: by more than U.
    """

    campaign: str
    quantity: str
    unit: str
    compared: int
    changed: int
    above_one: int
    percentiles: tuple[float, ...]


@dataclass(frozen=True)
class Flip:
    """An estimate with another verdict or another quality, or that is gone ("")."""

    session: str
    uut: str
    quantity: str
    conditions: Mapping[str, Any]
    unit: str
    released_value: float | None
    released_expanded_uncertainty: float | None
    released_verdict: str
    released_quality: str
    value: float | None
    expanded_uncertainty: float | None
    verdict: str
    quality: str


@dataclass(frozen=True)
class Concerned:
    """A certificate of which some numbers or verdicts would be others, or whose session gave nothing (``code``).

    ``largest``: change in units of U, with its sign, of ``largest_of``; None if none can be compared.
    """

    number: str
    specimen: bool
    customer: str
    uut: str
    session: str
    issued: str
    replaced_by: tuple[str, ...]
    flips: int
    changed: int
    largest: float | None
    largest_of: str
    released_software: str
    released_method: str
    method: str
    code: str


@dataclass(frozen=True)
class Changes:
    """The report on a trial; ``register``: by certificate as recorded, what stood in its place."""

    trial: str
    state: str
    started_utc: str
    software: str
    released_software: tuple[str, ...]
    method: str
    register: Mapping[str, Any]
    selection: Mapping[str, str]
    sessions: int
    simulated: bool
    failed: Mapping[str, int]
    failures: tuple[Mapping[str, str], ...]  # session, code, fault
    quantities: tuple[QuantityChange, ...]
    flips: tuple[Flip, ...]
    certificates: tuple[Concerned, ...]
    standards: tuple[Evidence, ...]


def changes_of(stored: StoredTrial, sessions: Mapping[str, Row], standards: Sequence[Evidence]) -> Changes:
    """Compare what a trial gave with what is released.

    Args:   stored: rows of the trial, and certificates.   sessions: of the archive, by hash (or place).
            standards: the last good evidence of each that is in question.
    """
    rows = [{**row, **_session(sessions.get(row["session_sha256"], {}))} for row in stored.rows]
    failures = [row for row in rows if row["code"]]
    trial = stored.trial
    return Changes(
        trial=trial.name,
        state=stored.state,
        started_utc=stored.started_utc,
        software=trial.software,
        released_software=tuple(sorted({row["released_software"] for row in rows} - {""})),
        method=trial.method,
        register=trial.register,
        selection=trial.selection,
        sessions=len({row["session_sha256"] for row in rows}),
        simulated=any(row["simulated"] for row in rows),
        failed=dict(sorted(Counter(str(row["code"]) for row in failures).items())),
        failures=tuple({name: str(row[name]) for name in ("session", "code", "fault")} for row in failures),
        quantities=tuple(_quantities(rows)),
        flips=tuple(_flip(row) for row in rows if is_flip(row)),
        certificates=tuple(_concerned(stored, rows)),
        standards=tuple(standards),
    )


def _session(row: Row) -> Row:
    names = {"session": "", "campaign": "", "simulated": False}
    return {name: row.get(name, default) for name, default in names.items()}


def change_in_u(row: Row) -> float | None:
    """Return (new - released) / U released; None if one side is no sound value, or U is 0."""
    released, expanded = row["released_value"], row["released_expanded_uncertainty"]
    if not expanded or released is None or row["value"] is None or row["expanded_uncertainty"] is None:
        return None
    return float((row["value"] - released) / expanded)


def is_changed(row: Row) -> bool:
    """Return whether a value or its uncertainty is another one to 1e-9, or stands on one side only."""
    pairs = [(row[name], row[f"released_{name}"]) for name in ("value", "expanded_uncertainty")]
    least = REL_TOL * max((abs(number) for number in pairs[1] if number is not None), default=0.0)
    return any(
        (now is None) != (then is None) or (now is not None and abs(now - then) > max(least, REL_TOL * abs(then)))
        for now, then in pairs
    )


def is_flip(row: Row) -> bool:
    """Return whether a released estimate would have another verdict or quality; one of a failed session has none."""
    if row["code"] or not row["released_quality"]:
        return False
    return any(row[name] != row[f"released_{name}"] for name in ("verdict", "quality"))


def _quantities(rows: Sequence[Row]) -> Iterator[QuantityChange]:
    known = [row for row in rows if row["quantity"] and row["released_quality"]]
    by_quantity = grouped(known, itemgetter("campaign", "quantity", "unit"))
    for (campaign, quantity, unit), members in sorted(by_quantity.items()):
        in_u = np.array([change for row in members if (change := change_in_u(row)) is not None])
        yield QuantityChange(
            campaign,
            quantity,
            unit,
            compared=in_u.size,
            changed=sum(map(is_changed, members)),
            above_one=int((np.abs(in_u) > 1.0).sum()),
            percentiles=tuple(np.percentile(in_u, _SHARES).tolist()) if in_u.size else (),
        )


def _flip(row: Row) -> Flip:
    names = ("session", "quantity", "conditions", "unit", "value", "expanded_uncertainty", "verdict", "quality")
    both = {f"released_{name}": row[f"released_{name}"] for name in names[4:]}
    return Flip(uut=_uut(row), **{name: row[name] for name in names}, **both)


def _uut(row: Row) -> str:
    return f"{row['uut_model']} {row['uut_serial']}".strip()


def _concerned(stored: StoredTrial, rows: Sequence[Row]) -> Iterator[Concerned]:
    """Yield the certificates that a trial concerns, the largest change first, those without a result before them."""
    by_session = grouped(rows, itemgetter("session_sha256"))
    concerned = [
        _certificate(row, by_session[row["session_sha256"]])
        for row in stored.certificates
        if any(member["code"] or is_flip(member) or is_changed(member) for member in by_session[row["session_sha256"]])
    ]
    yield from sorted(concerned, key=lambda entry: (entry.code == "", -abs(entry.largest or 0.0), entry.number))


def _certificate(row: Row, members: Sequence[Row]) -> Concerned:
    in_u = [(change, member) for member in members if (change := change_in_u(member)) is not None]
    largest, of = max(in_u, key=lambda pair: abs(pair[0]), default=(None, {}))
    return Concerned(
        **{name: row[name] for name in ("number", "specimen", "customer", "session", "issued")},
        uut=_uut(row),
        replaced_by=tuple(row["replaced_by"]),
        flips=sum(map(is_flip, members)),
        changed=sum(map(is_changed, members)),
        largest=largest,
        largest_of=str(of.get("quantity", "")),
        released_software=row["software"],
        released_method=row["method"],
        method=str(members[0]["method"]),
        code=str(members[0]["code"]),
    )


def verdict_text(verdict: str, quality: str, gone: str) -> str:
    """Return how an estimate was judged, or why it was not; ``gone``: the word for one that there is not."""
    if not quality:
        return gone
    return quality if verdict == "none" else verdict_words(verdict)
