"""The pages of docs/instruments, from the tables beside the drivers."""

from __future__ import annotations

import sys
from pathlib import Path

from bench.model.drivers import Manual, manual_of
from bench.model.installed import driver_packages

STATES = ("confirmed", "derived", "unconfirmed")


def page(driver: str, manual: Manual) -> str:
    """Return the table of a driver as a page of Markdown."""
    counts = {state: sum(one.state == state for one in manual.commands.values()) for state in STATES}
    rows = [
        f"| `{form}` | {_cell(one.reply)} | {one.touch} | {one.source} | {one.state} |"
        for form, one in manual.commands.items()
    ]
    return "\n".join(
        [
            f"# {manual.instrument}",
            "",
            f"What the driver `{driver}` sends, as [its file](../../instruments/{driver}.yaml) has it. "
            + ", ".join(f"{count} {state}" for state, count in counts.items())
            + "; none of it was tried on hardware by us: [first contact](../first-contact.md).",
            "",
            *(f"* {key}: {text}" for key, text in manual.sources.items()),
            "",
            "| command | form of the reply | it | source | state |",
            "|---|---|---|---|---|",
            *rows,
            "",
        ]
    )


def _cell(reply: str) -> str:
    return f"`{reply}`".replace("|", "\\|") if reply else "–"


def write_pages(folder: Path) -> None:
    """Write the page of every driver that has a table."""
    for package in driver_packages():
        for path in sorted(package.folder.glob("*.yaml")):
            manual = manual_of(path.stem)
            assert manual is not None
            (folder / f"{path.stem}.md").write_text(page(path.stem, manual), encoding="utf-8")


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))
