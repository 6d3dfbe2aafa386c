"""Arrays in, results out: no file, clock or logger."""
