"""Logs of inertial units that other systems recorded."""
