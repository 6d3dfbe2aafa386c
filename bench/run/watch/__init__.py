"""Watches while steps run: interlocks, temperatures, clocks, trend."""
