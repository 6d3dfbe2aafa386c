"""Hysteresis with a thermal lag: play operators, search, solution."""
