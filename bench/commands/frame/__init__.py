"""``bench decode`` and ``bench frame``."""
