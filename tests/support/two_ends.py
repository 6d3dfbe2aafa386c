"""How test files are shared out: those that wait have workers of their own while those that compute use the cores."""

from collections import Counter
from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController


def computes(worker: str) -> bool:
    """Return whether a worker (gw0, gw1, ...) begins with the tests that compute: every second one does."""
    return int(worker.removeprefix("gw")) % 2 == 1


def arrange(items: list[pytest.Item]) -> None:
    """Sort whole files: those with tests that wait in front, longest first; those that compute longest at the end."""
    waits, slow = Counter[str](), Counter[str]()
    for item in items:
        waits[file_of(item.nodeid)] += item.get_closest_marker("waits") is not None
        slow[file_of(item.nodeid)] += item.get_closest_marker("slow") is not None

    def place(item: pytest.Item) -> tuple[bool, int, int]:
        name = file_of(item.nodeid)
        return not waits[name], -slow[name] if waits[name] else slow[name], -waits[name]

    items.sort(key=place)


def file_of(nodeid: str) -> str:
    """Return the path in the name of a test."""
    return nodeid.partition("::")[0]


class TwoEnds(LoadScopeScheduling):
    """One queue of files, taken from its front by the workers that wait and from its end by those that compute.

    So neither runs dry before all is done; and a file is not torn apart, for what its tests share is made once.
    """

    def __init__(self, config: pytest.Config, log: Any) -> None:
        config.option.loadscopereorder = False  # by the number of tests, which says nothing of their time
        super().__init__(config, log)

    def _split_scope(self, nodeid: str) -> str:
        return file_of(nodeid)

    def _assign_work_unit(self, node: WorkerController) -> None:
        if computes(node.gateway.id):
            self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
        super()._assign_work_unit(node)
