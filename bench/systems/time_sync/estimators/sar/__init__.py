"""Radar images: pulses, focusing, point response."""
