"""Drift of an inertial unit over and between its rests."""
