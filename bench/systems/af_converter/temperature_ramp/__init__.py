"""Ramps that other systems logged."""
