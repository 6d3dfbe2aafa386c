"""Watches while steps run: interlocks, deviations, temperatures, clocks, trend."""
