"""Estimators of inertial units: arrays in, result out."""
