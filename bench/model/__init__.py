"""The foundation of all packages: clock, ports, units, errors, quality flags and the strict YAML loader."""
