"""Pages of the instruments, from the tables beside the drivers: commands, and rows of the state table."""

from __future__ import annotations

from bench.model.drivers import Condition, Manual, manual_of
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
            f"What the driver `{driver}` sends, as its file `instruments/{driver}.yaml` has it. "
            + ", ".join(f"{count} {state}" for state, count in counts.items())
            + "; none of it was tried on hardware by us: [first contact](../instruments.md#first-contact).",
            "",
            *(f"* {key}: {text}" for key, text in manual.sources.items()),
            "",
            "| command | form of the reply | it | source | state |",
            "|---|---|---|---|---|",
            *rows,
            "",
            "| setting or condition | at | how it is had right | otherwise | source |",
            "|---|---|---|---|---|",
            *(
                f"| {name} | {', '.join(one.when)} | {had_right(one)} | {one.why} | {one.source} |"
                for name, one in manual.states.items()
            ),
            "",
        ]
    )


def had_right(condition: Condition) -> str:
    """Return how a row of the state table is had right: set, asked, refused, or not covered."""
    ways = [f"set by `{command}`" for command in (condition.set, *condition.by) if command]
    if condition.ask:
        ways.append(f"{'confirmed' if condition.set else 'refused unless right'} by `{condition.ask}`")
    return ", ".join(ways) or "not covered"


def _cell(reply: str) -> str:
    return f"`{reply}`".replace("|", "\\|") if reply else "–"


def manual_pages() -> dict[str, str]:
    """Return the page of every driver that has a table, by its place below docs/."""
    names = sorted(path.stem for package in driver_packages() for path in package.folder.glob("*.yaml"))
    return {f"instruments/{name}.md": page(name, manual) for name in names if (manual := manual_of(name)) is not None}
