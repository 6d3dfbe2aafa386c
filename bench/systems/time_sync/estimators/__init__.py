"""Estimators of the time offset: arrays in, result out."""
