"""The timer-driven sequencer, serial acquisition, and the opened bench."""

from bench.run import called
