"""``bench history``."""
