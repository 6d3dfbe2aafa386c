"""Estimators that no system owns: arrays in, result out; no file, clock or logger."""
