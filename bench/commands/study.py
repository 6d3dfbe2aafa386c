"""``bench study``: a Monte Carlo study on this machine or on many; writes study.json and report.html."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.analysis import Study, Task, estimates_of
from bench.commands.console import TaskLines, console, warn
from bench.commands.requests import StudyRequest
from bench.maths.verdict import passed
from bench.model.errors import ExitStatus, InputError
from bench.model.extras import missing_extra
from bench.model.installed import named, refuse_unknown
from bench.model.systems import own_systems, system_refusals, systems
from bench.report import study_html
from bench.session.output import make_folder, write_file
from bench.session.view import SOFTWARE

JSON_NAME, PAGE_NAME = "study.json", "report.html"


def study(request: StudyRequest) -> int:
    """Run a study.

    Returns: 1 if a verdict fails, else 0.
    Raises:  InputError B-STUDY-001 to B-STUDY-006 and InstallationError B-PKG-001, B-PKG-004 before anything is
             computed, B-CLI-007 if a file cannot be written;
             RunError B-STUDY-007 if the cluster fails.
    """
    chosen: Study = named(_module_of(request.name))
    options = chosen.checked_options(request.runs, request.seed, request.offsets, request.quick)
    make_folder(request.out)
    results = _computed(chosen, chosen.tasks_of(options), request.dask)
    return _written(request, chosen, options, results)


def _module_of(name: str) -> str:
    """Return the module of a study; foreign systems are asked for what the bench does not have."""
    offered: dict[str, str] = {}
    for known in (own_systems, systems):
        offered = {name: module for system in known() for name, module in system.studies.items()}
        if name in offered:
            return offered[name]
    refuse_unknown(f"the study {name!r}", name, system_refusals())
    raise InputError("B-STUDY-001", f"there is no study {name!r}", next_step=f"known: {', '.join(offered)}")


def _computed(chosen: Study, tasks: Sequence[Task], where: str | None) -> list[Any]:
    """Return the result of each task, in the order of the tasks, wherever they ran."""
    lines = TaskLines(len(tasks))
    if where is not None:
        from bench.commands.cluster import run_on_cluster

        return run_on_cluster(where, tasks, chosen.run_task, lines.done)
    results = []
    for task in tasks:
        results.append(chosen.run_task(task))
        lines.done(task.name)
    return results


def _written(request: StudyRequest, chosen: Study, options: Any, results: Sequence[Any]) -> int:
    studied = chosen.results_of(options, results)
    document = chosen.study_document(options, studied, SOFTWARE)
    text = chosen.study_json(document)
    written = [(request.out / JSON_NAME, text)]
    try:
        page = study_html(document, chosen.study_chapters(options, document, studied), SOFTWARE)
        written.append((request.out / PAGE_NAME, page))
    except ModuleNotFoundError as error:
        warn(missing_extra(error))
    for path, content in written:
        write_file(path, content)
    if request.json:
        sys.stdout.write(text)
    else:
        _tell(document, [path for path, _ in written])
    well = passed(estimate.verdict for estimate in estimates_of(document))
    return ExitStatus.PASS if well else ExitStatus.VERDICT_FAIL


def _tell(document: dict[str, Any], written: Sequence[Path]) -> None:
    out = console()
    judged = [estimate for estimate in estimates_of(document) if estimate.verdict != "none"]
    failed = [estimate for estimate in judged if not passed([estimate.verdict])]
    out.print(f"{len(judged) - len(failed)} tolerances kept, {len(failed)} not, {document['runs']} runs of each case")
    for estimate in failed:
        where = ", ".join(f"{name} {value}" for name, value in estimate.conditions.items())
        out.print(f"fail       {estimate.quantity} = {estimate.value:.5g} {estimate.unit}  ({where})")
    for path in written:
        out.print(f"wrote      {path}")
