"""``bench archive``."""
