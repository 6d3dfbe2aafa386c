"""Estimators of north: arrays in, result out."""
