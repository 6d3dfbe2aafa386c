"""``bench study``."""
