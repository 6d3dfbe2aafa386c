"""Flights of the simulated vehicle: path, Earth, and the errors of its inertial unit and its EGI."""
