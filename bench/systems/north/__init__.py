"""North finding with a fibre-optic gyroscope on a turning table."""
