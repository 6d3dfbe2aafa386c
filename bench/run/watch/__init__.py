"""Watches while steps run: interlocks, deviations, clocks, trend."""
