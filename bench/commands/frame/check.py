"""``bench frame check``: a definition and its golden frames."""

from __future__ import annotations

from bench.commands.console import say
from bench.commands.origin import named_file
from bench.frame import load_frame, pace_of
from bench.model.clock import WallClock
from bench.model.errors import ExitStatus


def check(frame: str) -> int:
    """Print what a definition describes and how it is decoded. Raises: InputErrors with every mistake in it."""
    definition = load_frame(named_file("frames", frame))
    messages = ", ".join(definition.messages)
    say(f"{definition.name}: messages {messages}; golden frames are right; sha256 {definition.sha256}")
    say(str(pace_of(definition, WallClock())))
    return ExitStatus.PASS
