"""Platinum resistance thermometers, calibrated in the chamber: what the bench finds by its entry points."""
