"""Control charts of calibrations: predictions, run lengths, limits, signals.

Its modules are public, as all of ``bench.maths``.
"""
