"""Estimators of the ring laser's beat: arrays in, result out."""
