"""``bench batch``: every session named is fitted, and all of them are looked at together.

One session after the other, and nothing of one is kept but its estimates: the memory does not grow with their length.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from bench.commands.console import console, warn
from bench.maths.verdict import is_refused
from bench.model.errors import BenchError, ExitStatus, FitError, InputError
from bench.model.extras import missing_extra
from bench.report import Batch, LeftOut, Outcome, batch_html, batch_json, unit_name
from bench.session.output import write_file
from bench.session.service import read_view
from bench.session.view import SOFTWARE, analyse_view

SEGMENTS = "session.*.mcap"
JSON_NAME, PAGE_NAME = "batch.json", "batch.html"
_SHOWN = 20


def batch(named: Sequence[Path], out: Path, as_json: bool) -> int:
    """Fit and compare sessions; writes batch.json and batch.html.

    Returns: 5 if a session is damaged or cannot be read, else 1 if a verdict fails or a session determines no result,
             else 0.
    Raises:  InputError B-CLI-013 if a path holds no session, B-CLI-007 if a file cannot be written.
    """
    folders = list(dict.fromkeys(folder for path in named for folder in session_folders(path)))
    batch, status = Batch(), ExitStatus.PASS
    for folder, name in zip(folders, _names(folders), strict=True):
        status = max(status, _add(batch, folder, name))
    document = batch_json(batch, SOFTWARE)
    written = [(out / JSON_NAME, document)]
    try:
        written.append((out / PAGE_NAME, batch_html(batch, SOFTWARE)))
    except ModuleNotFoundError as error:
        warn(missing_extra(error))
    for path, text in written:
        write_file(path, text)
    if as_json:
        sys.stdout.write(document)
    else:
        _tell(batch, [path for path, _ in written])
    return max(status, ExitStatus.VERDICT_FAIL) if batch.yield_of().failed else status


def session_folders(path: Path) -> list[Path]:
    """Return the session a path names, or all in its folder, or all that match it. Raises: InputError B-CLI-013."""
    if _is_session(path):
        return [path]
    matches: Iterable[Path] = path.iterdir() if path.is_dir() else _matches(path)
    folders = sorted(path for path in matches if _is_session(path))
    if not folders:
        raise InputError(
            "B-CLI-013",
            "is no session, and holds none",
            where=path,
            next_step="name folders with session.0001.mcap, or a folder of such folders",
        )
    return folders


def _is_session(path: Path) -> bool:
    return path.is_dir() and any(path.glob(SEGMENTS))


def _matches(pattern: Path) -> Iterator[Path]:
    """Return what a pattern in quotes matches; a shell has replaced any other."""
    anchor = Path(pattern.anchor) if pattern.anchor else Path()
    relative = pattern.relative_to(pattern.anchor) if pattern.anchor else pattern
    return anchor.glob(str(relative)) if any(sign in str(pattern) for sign in "*?[") else iter(())


def _names(folders: Sequence[Path]) -> list[str]:
    """Return names of the folders; with that of the folder around them where two have one name."""
    names = [folder.resolve().name for folder in folders]
    if len(set(names)) == len(names):
        return names
    return [str(Path(folder.resolve().parent.name, folder.resolve().name)) for folder in folders]


def _add(batch: Batch, folder: Path, name: str) -> ExitStatus:
    """Add one session, or say why it is left out."""
    try:
        view = read_view(folder)
    except BenchError as error:
        batch.left_out.append(LeftOut(name, error.code, error.message))
        return ExitStatus.SESSION_DAMAGED
    status = ExitStatus.PASS
    if view.damaged:
        batch.damaged.append(name)
        batch.left_out.append(LeftOut(name, "B-REC-011", "; ".join(view.remarks)))
        status = ExitStatus.SESSION_DAMAGED
    if not view.has_analysis:
        batch.left_out.append(LeftOut(name, "B-CLI-008", "the sequence of this session asks for no analysis"))
        return status
    try:
        results, analysis = analyse_view(view)
    except BenchError as error:
        batch.left_out.append(LeftOut(name, error.code, error.message))
        batch.without_result(view.manifest, name)
        return max(status, ExitStatus.VERDICT_FAIL if isinstance(error, FitError) else ExitStatus.SESSION_DAMAGED)
    batch.add(results, name, analysis.missing)
    return status


def _tell(batch: Batch, written: Sequence[Path]) -> None:
    out = console()
    total = batch.yield_of()
    low, high = total.interval
    share = "" if total.share is None else f"; yield {100 * total.share:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
    counts = f"{total.passed} pass, {total.failed} fail, {total.without} without a verdict"
    out.print(f"{len(batch.outcomes)} units in {len({part.session for part in batch.parts})} sessions: {counts}{share}")
    if batch.doubted:
        units = ", ".join(unit_name(unit) for unit in batch.doubted[:_SHOWN])
        out.print(f"{len(batch.doubted)} units with doubt, at least one estimate is not sound: {units}")
    bad = [part for part in batch.parts if is_refused(part.outcome) or part.outcome == Outcome.NO_RESULT]
    for part in bad[:_SHOWN]:
        said = part.outcome.replace("_", " ")
        out.print(f"{said:<10} {unit_name(part.unit)}  {part.session}: {part.failed} of {part.judged} judged failed")
    if len(bad) > _SHOWN:
        out.print(f"... and {len(bad) - _SHOWN} more in {JSON_NAME}")
    for left_out in batch.left_out:
        out.print(f"left out   {left_out.session}: {left_out.code} {left_out.text}")
    for path in written:
        out.print(f"wrote      {path}")
