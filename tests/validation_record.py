"""A pytest plugin for the validation record: what each test marked ``validates`` is held against, and its figure.

A test leaves its figure with ``record_property("obtained", "rms error 0.12 ppm, limit 0.5")``.
"""

import platform
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import pytest
from public_captures import section

OPTION = "--validation-record"
OBTAINED = "obtained"
_HEAD = """\
# Validation record

What is validated, what it is held against that nobody wrote here, the figure obtained, and the test that does it.
`make validate` writes this file again ([validation](../docs/validation.md)); a row of a test that fails says so.

"""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(OPTION, metavar="FILE", help="run the tests marked 'validates' only and write their record")


def pytest_configure(config: pytest.Config) -> None:
    path = config.getoption(OPTION)
    if path:
        config.pluginmanager.register(_Record(Path(path)), "validation-record")


class _Record:
    """Collects items, outcomes and figures; writes the table at the end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.items: dict[str, tuple[str, str]] = {}  # test -> (what, against)
        self.failed: set[str] = set()
        self.skipped: set[str] = set()
        self.figures: dict[str, list[str]] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        chosen = [item for item in items if item.get_closest_marker("validates")]
        config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
        items[:] = chosen
        for item in chosen:
            marker = item.get_closest_marker("validates")
            self.items[_test(item.nodeid)] = (marker.args[0], marker.kwargs["against"])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        test = _test(report.nodeid)
        if report.failed:
            self.failed.add(test)
        if report.skipped:
            self.skipped.add(test)
        if report.when == "call":
            found = self.figures.setdefault(test, [])
            found += [str(value) for name, value in report.user_properties if name == OBTAINED]

    def pytest_sessionfinish(self) -> None:
        rows = ["| what | held against | figure obtained | test |", "|---|---|---|---|", *sorted(self._rows())]
        self.path.write_text(_HEAD + _environment() + "\n".join([*rows, *section()]) + "\n", encoding="utf-8")

    def _rows(self) -> Iterator[str]:
        for test, (what, against) in self.items.items():
            figure = "; ".join(dict.fromkeys(self.figures.get(test, []))) or "agrees"
            if test in self.skipped:
                figure = "not run: what it is held against is absent"
            if test in self.failed:
                figure = f"**FAILED** {figure}"
            yield f"| {what} | {against} | {figure} | `{test}` |"


def _test(nodeid: str) -> str:
    """A test without its parameters."""
    return nodeid.partition("[")[0]


def _environment() -> str:
    packages = ", ".join(f"{name} {version(name)}" for name in ("inertial-bench", "numpy", "scipy"))
    return f"Obtained with Python {platform.python_version()}, {packages}.\n\n"
