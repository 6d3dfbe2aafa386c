"""Floor 3: the timer-driven sequencer, serial acquisition, and the opened bench."""

from bench.run.session import Conducted, conduct

__all__ = ["Conducted", "conduct"]
