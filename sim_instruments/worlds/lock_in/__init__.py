"""A dithered ring laser, edge by edge."""
