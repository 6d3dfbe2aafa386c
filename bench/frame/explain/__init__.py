"""What a raw capture says about its own frames or lines, for the author of a definition."""

from bench.frame.explain.draft import LineGuess, draft, line_guess
from bench.frame.explain.frames import LOOKED_AT_BYTES, Guess, checks_that_fit, guesses
