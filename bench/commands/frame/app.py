"""``bench frame``: help for the author of a frame definition."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from bench.commands.usage import App

app = App(help="Begin a frame definition.")


@app.command(
    work="frame.explain", epilog="Example: bench frame new capture.bin --name my_device --out frames/my_device.yaml"
)
def new(
    capture: Annotated[Path, Argument(help="a raw capture of any length; - reads standard input")],
    name: Annotated[str, Option(help="of the definition")] = "my_device",
    out: Annotated[Path | None, Option(help="the file; default: standard output")] = None,
) -> None:
    """Write a first definition from a capture: sync bytes, length and check, as its bytes show them."""


@app.command(work="frame.decode", epilog="Example: bench frame check frames/my_device.yaml")
def check(frame: Annotated[str, Argument(help="a frame file, or the name of one")]) -> None:
    """Check a definition against its golden frames, and say how fast it is decoded here."""
