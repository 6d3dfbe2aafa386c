"""Two navigation units and a radar on a flight."""
