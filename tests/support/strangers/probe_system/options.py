"""Nothing can be chosen at this bench."""

OPTIONS: dict[str, str] = {}
NUMBERS: dict[str, tuple[str, float, float]] = {}
TEXTS: dict[str, tuple[str, tuple[str, ...]]] = {}
