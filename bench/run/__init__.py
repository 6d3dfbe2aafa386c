"""Floor 3: the timer-driven sequencer, serial acquisition, and the opened bench."""
