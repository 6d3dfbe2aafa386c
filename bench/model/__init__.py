"""Floor 0: clock, ports, units, errors, quality flags and the strict YAML loader."""
