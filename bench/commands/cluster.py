"""Tasks of a study or of the archive on a Dask cluster: one that runs already, or processes of this machine.

A task computes the same on any worker with the same software, and its results are put together in the order of the
tasks: which worker took which task, or died over it, changes no byte.
"""

from __future__ import annotations

import asyncio
import logging
import os
import platform
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

from bench import __version__
from bench.analysis import Task
from bench.model.errors import BenchError, InputError, RunError
from bench.model.lab import in_words

EXTRA = "cluster"
CONNECT_s, WORKERS_s = 15, 60
MOST_WORKERS = 256
COMPARED = ("numpy", "scipy", "distributed")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
# Dask's own MALLOC_TRIM_THRESHOLD_ of 65536 makes the C library give back every array at once, and the system clears
# each page anew for the next one: most of the time of a worker. What stands in the environment counts before it.
KEPT_BYTES = str(1 << 30)
ALLOCATOR = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")
_LOCAL, _ADDRESS = re.compile(r"local:(\d{1,4})"), re.compile(r"(tcp|tls)://[^\s/:]+(:\d{1,5})?|tcp://\[[^\s\]]+\]:\d+")
_HELP = "use tcp://host:port of a scheduler that runs, or local:N for N processes on this machine"


def run_on_cluster(
    where: str, tasks: Sequence[Task], run_task: Callable[[Any], Any], done: Callable[[str], object]
) -> list[Any]:
    """Return results of the tasks, in their order.

    Args:    where: ``tcp://host:port`` or ``local:N``.   done: told the name of each task, in any order.
    Raises:  InputError B-STUDY-003 for any other place, B-STUDY-004 without Dask, B-STUDY-005 if the scheduler or a
             worker does not answer, B-STUDY-006 if a worker has other software or more threads; RunError B-STUDY-007
             if a task fails there, or is lost with its workers more often than Dask allows.
    """
    outcomes = {}
    for task, result, wrong in completed_on_cluster(where, tasks, run_task):
        done(task.name)
        outcomes[id(task)] = result, wrong
    results = []
    for task in tasks:
        result, wrong = outcomes[id(task)]
        if wrong:
            raise failed(task, wrong)
        results.append(result)
    return results


def completed_on_cluster(
    where: str, tasks: Sequence[Task], run_task: Callable[[Any], Any]
) -> Iterator[tuple[Any, Any, str]]:
    """Yield each task as it is done, with its result, or with what went wrong; in any order.

    Raises: as ``run_on_cluster``, but for a task that fails.
    """
    if not _LOCAL.fullmatch(where) and not _ADDRESS.fullmatch(where):
        raise InputError("B-STUDY-003", f"{where!r} is no place to compute at", where="--dask", next_step=_HELP)
    try:
        import distributed
    except ModuleNotFoundError as error:
        text = f"--dask needs the package {error.name}, which is not installed"
        step = f"install inertial-bench[{EXTRA}], or leave --dask out"
        raise InputError("B-STUDY-004", text, where="--dask", next_step=step) from error
    dask: Any = distributed  # it has no types
    with _connected(dask, where) as client:
        _check(where, client)
        futures = {client.submit(run_there, run_task, task, pure=False): task for task in tasks}
        by_key = {future.key: task for future, task in futures.items()}
        left = dask.as_completed(futures)
        del futures  # a result is let go once it was handed on
        for future in left:
            yield by_key[future.key], *outcome_of(future)


@contextmanager
def _connected(distributed: Any, where: str) -> Iterator[Any]:
    """A client of the cluster; a local one lives as long as this does."""
    for name in ("distributed", "distributed.client"):  # Dask gives the second a level of its own
        logging.getLogger(name).setLevel(logging.CRITICAL)  # a worker that dies is told of by what it did
    local = _LOCAL.fullmatch(where)
    cluster = None
    try:
        if local:
            count = int(local[1])
            if not 1 <= count <= MOST_WORKERS:
                text = f"{count} workers are not possible, 1 to {MOST_WORKERS} are"
                raise InputError("B-STUDY-003", text, where="--dask", next_step=_HELP)
            cluster = _local_cluster(distributed, count)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # versions are compared below, and a mismatch is an error there
            client = _client(distributed, where, cluster)
        try:
            yield client
        finally:
            client.close()
    finally:
        if cluster is not None:
            cluster.close()


def _local_cluster(distributed: Any, count: int) -> Any:
    for variable in THREADS:
        os.environ.setdefault(variable, "1")
    for variable in ALLOCATOR:
        os.environ.setdefault(variable, KEPT_BYTES)
    return distributed.LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
        memory_limit=0,
        silence_logs=logging.CRITICAL,
    )


def _client(distributed: Any, where: str, cluster: Any) -> Any:
    try:
        client = distributed.Client(cluster or where, timeout=CONNECT_s)
    except (OSError, TimeoutError, ValueError) as error:
        text = f"no scheduler answers within {CONNECT_s} s"
        step = "start one with 'dask scheduler' and look at the address it prints, or use --dask local:N"
        raise InputError("B-STUDY-005", text, where=where, next_step=step) from error
    try:
        client.wait_for_workers(1, timeout=WORKERS_s)
    except TimeoutError as error:
        client.close()
        text = f"the scheduler has no worker after {WORKERS_s} s"
        step = f"start some: 'dask worker {where} --nthreads 1 --nworkers N'"
        raise InputError("B-STUDY-005", text, where=where, next_step=step) from error
    return client


def software_here() -> dict[str, str]:
    """Return versions numbers may depend on, and the threads of the linear algebra, of the process that is asked."""
    versions = {name: version(name) for name in COMPARED}
    threads = {name: os.environ.get(name, "not set") for name in THREADS}
    return {"inertial-bench": __version__, "python": platform.python_version(), **versions, **threads}


def _check(where: str, client: Any) -> None:
    try:
        by_worker: Mapping[str, Mapping[str, str]] = client.run(software_here)
    except Exception as error:  # whatever it is that an unknown worker lacks
        text = f"the workers cannot run the bench: {in_words(error)[:200]}"
        raise _other_software(where, text) from error
    here = {**software_here(), **dict.fromkeys(THREADS, "1")}
    for worker, versions in by_worker.items():
        for name, due in here.items():
            if versions.get(name) != due:
                text = f"worker {worker} has {name} {versions.get(name, 'not at all')}; {due} is due, as here"
                raise _other_software(where, text)


def _other_software(where: str, text: str) -> InputError:
    step = f"give every worker the locked packages and this release, with {'=1 '.join(THREADS)}=1"
    return InputError("B-STUDY-006", text, where=where, next_step=step)


def run_there(run_task: Callable[[Any], Any], task: Task) -> tuple[Any, str]:
    """Return result of a task, or what went wrong in words: an error of the bench need not travel as an object."""
    try:
        return run_task(task), ""
    except BenchError as error:
        return None, str(error)


def outcome_of(future: Any) -> tuple[Any, str]:
    """Return the result of a future, or what went wrong in words."""
    try:
        result, wrong = future.result()
    except (Exception, asyncio.CancelledError) as error:
        return None, in_words(error)[:300]
    return result, wrong


def failed(task: Task, wrong: str) -> RunError:
    """Return the error for a task that the cluster could not do."""
    step = "look at the workers' own logs (memory?), then start again; on one machine leave --dask out"
    return RunError("B-STUDY-007", f"{task.name} failed on the cluster: {wrong}", next_step=step)
