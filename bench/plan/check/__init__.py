"""The static check: what a plan would do wrong, found before anything is touched."""
