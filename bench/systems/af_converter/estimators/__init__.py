"""Estimators of the AF converter: arrays in, result out."""
