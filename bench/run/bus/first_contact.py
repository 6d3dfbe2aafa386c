"""The first contact with an instrument: its driver's commands one by one, each reply held against the manual's form.

Harmless commands come first; before anything energises or moves somebody at the bench is asked. What was seen is a
commissioning record, beside the station file: a driver with commands that no manual confirms is used on a real bench
only where such a record of that model and firmware exists.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.model.drivers import Manual, replies_so
from bench.model.errors import BenchError
from bench.model.ports import Identity
from bench.model.quantities import Values

FOLDER = "commissioning"
AS_DOCUMENTED, DIFFERS, SILENT, REFUSED, NOT_TRIED = "as documented", "differs", "no answer", "refused", "not tried"
Ask = Callable[[str], bool]


@dataclass(frozen=True)
class Tried:
    """One command: its form in the manual, what was sent, what came, what is documented, and how they agree."""

    form: str
    sent: str
    said: str
    documented: str
    outcome: str


def walk(instrument: Any, manual: Manual, ask: Ask, tell: Callable[[Tried], None]) -> list[Tried]:
    """Try what its model has and may be sent alone; at the end again what had no answer, and questions that went wrong.

    Args: instrument: a driver that was introduced.   ask: somebody at the bench, before what energises or moves.
          tell: gets each command as soon as it was tried.
    """
    tried: dict[str, Tried] = {}
    for form in manual.in_order(instrument.options):
        tried[form] = _tried(instrument, form, manual, ask)
        tell(tried[form])
    for form, seen in list(tried.items()):
        asked = seen.outcome in (DIFFERS, REFUSED) and manual.commands[form].touch == "asks"
        if asked or seen.outcome == SILENT:
            tried[form] = _tried(instrument, form, manual, ask)
            tell(tried[form])
    return list(tried.values())


def _tried(instrument: Any, form: str, manual: Manual, ask: Ask) -> Tried:
    command, before = manual.commands[form], manual.find(manual.commands[form].after)
    if not command.example:
        return Tried(form, "", "", command.reply, NOT_TRIED)
    touches = [manual.commands[one].touch for one in (before, form) if one is not None]
    dangerous = next((touch for touch in touches if touch in ("energises", "moves")), "")
    if dangerous and not ask(f"{command.example!r} {dangerous}: is nobody and nothing in danger, may it be sent?"):
        return Tried(form, "", "", command.reply, NOT_TRIED)
    known = manual.in_order(instrument.options)
    due = dict([row for row in command.shown.items() if manual.find(row[0]) in known][:1])
    said: list[str] = []
    outcome, problems = AS_DOCUMENTED, []
    try:
        if command.after:
            instrument.raw(command.after)
        reply = instrument.raw(command.example, answers=bool(command.reply)) or ""
        said += filter(None, [reply])
        problems = instrument.drain_errors()
        shown = {question: instrument.raw(question, answers=True) or "" for question in due}
        said += [f"{question} {answer}" for question, answer in shown.items()]
        forms = [(command.reply, reply), *((due[question], answer) for question, answer in shown.items())]
        if any(form and not replies_so(form, answer) for form, answer in forms):
            outcome = DIFFERS
    except BenchError as error:
        said.append(error.message)
        outcome = SILENT
        with suppress(BenchError):  # the next command is not blamed for it
            problems = instrument.drain_errors()
    finally:
        if dangerous:
            instrument.make_safe()
    if problems:
        said.append(told_once(problems))
        outcome = SILENT if outcome == SILENT else REFUSED
    documented = "; ".join([command.reply, *(f"{asked} {answer}" for asked, answer in due.items())])
    return Tried(form, command.example, "; ".join(said), documented.removeprefix("; "), outcome)


def told_once(problems: Sequence[str]) -> str:
    """Return problems in one line, each once with how often it came."""
    counts = Counter(problems)
    return "; ".join(f"{text} ({count} times)" if count > 1 else text for text, count in counts.items())


def record_of(role: str, driver: str, identity: Identity, by: str, at: str, tried: list[Tried]) -> dict[str, Any]:
    """Return the commissioning record; its hash is over everything else in it."""
    document = {
        "schema": 1,
        "role": role,
        "driver": driver,
        "identity": asdict(identity),
        "by": by,
        "at": at,
        "commands": [asdict(one) for one in tried],
    }
    return document | {"sha256": _hash(document)}


def page_of(record: Values) -> str:
    """Return the record as a page of Markdown."""
    who = record["identity"]
    rows = [
        f"| `{one['form']}` | {_shown(one['sent'])} | {_shown(one['said'])} | {_shown(one['documented'])} "
        f"| {one['outcome']} |"
        for one in record["commands"]
    ]
    return "\n".join(
        [
            f"# First contact: {record['role']}, {who['manufacturer']} {who['model']}",
            "",
            f"Serial number {who['serial'] or '–'}, firmware {who['firmware'] or '–'}; driver `{record['driver']}`. "
            f"By {record['by']}, {record['at']}. SHA-256 {record['sha256']}.",
            "",
            "| command | sent | reply | documented | outcome |",
            "|---|---|---|---|---|",
            *rows,
            "",
        ]
    )


def write_record(station: Path, record: Values) -> Path:
    """Write record and page into the station's folder and return the record's path; an older one stays."""
    folder = station.parent / FOLDER
    folder.mkdir(exist_ok=True)
    stamp = re.sub(r"[^0-9TZ]", "", record["at"])
    path = folder / f"{record['role']}_{stamp}.json"
    path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    path.with_suffix(".md").write_text(page_of(record), encoding="utf-8")
    return path


def unproved(station: Path, driver: str, manual: Manual, identity: Identity) -> list[str]:
    """Return the unconfirmed commands that no record of this driver, model and firmware has seen as documented."""
    seen: dict[str, str] = {}  # the newest record counts
    for record in sorted(_records(station), key=lambda record: str(record["at"])):
        who = record["identity"]
        if (record["driver"], who["model"], who["firmware"]) == (driver, identity.model, identity.firmware):
            seen |= {one["form"]: one["outcome"] for one in record["commands"] if one["outcome"] != NOT_TRIED}
    return [form for form in manual.unconfirmed if seen.get(form) != AS_DOCUMENTED]


def _records(station: Path) -> Iterator[dict[str, Any]]:
    """Yield the records that are whole: one that somebody changed does not count."""
    for path in sorted((station.parent / FOLDER).glob("*.json")):
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
            stated = record.pop("sha256")
        except (OSError, ValueError, KeyError, AttributeError, TypeError):
            continue
        if stated == _hash(record):
            yield record


def _hash(document: Values) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _shown(text: str) -> str:
    return f"`{text}`".replace("|", "\\|") if text else "–"
