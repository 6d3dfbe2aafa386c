"""A fibre-optic gyroscope on a turning table."""
