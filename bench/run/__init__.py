"""The timer-driven sequencer, serial acquisition, and the opened bench."""

from bench.run.called import CalledRoom as CalledRoom
