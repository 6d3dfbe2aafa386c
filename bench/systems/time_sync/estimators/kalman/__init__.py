"""The filter that carries the time offset as a state."""
