"""Bias over a temperature ramp, its hysteresis and its noise."""
