"""Where the sessions of an archive are computed: in this process, or on a Dask cluster."""

from __future__ import annotations

from functools import partial

from bench.archive.work import Compute, computed_here


def compute_at(dask: str | None) -> Compute:
    """Return what computes tasks, for an option ``--dask``; a cluster is looked for once there is a task."""
    if dask is None:
        return computed_here
    from bench.commands.cluster import completed_on_cluster

    return partial(completed_on_cluster, dask)
