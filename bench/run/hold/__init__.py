"""Holds: a run stands still and goes on."""
