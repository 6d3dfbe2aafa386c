"""Bias, its stability and its repeatability."""
