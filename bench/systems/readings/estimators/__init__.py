"""Estimators of values that are read."""
