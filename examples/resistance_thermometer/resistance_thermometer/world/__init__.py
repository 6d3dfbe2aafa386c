"""The simulated bench of the thermometers."""
