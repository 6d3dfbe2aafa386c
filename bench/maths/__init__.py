"""Estimators that no system owns: arrays in, result out; no file, clock or logger.

The modules are public: a face would load scipy for whoever needs a coverage factor.
"""
