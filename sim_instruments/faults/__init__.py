"""Faults of a simulated bench."""
