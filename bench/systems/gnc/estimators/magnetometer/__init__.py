"""Ellipse, ellipsoid and plane through magnetometer readings."""
