"""Time offset between two navigation units, judged on radar images."""
