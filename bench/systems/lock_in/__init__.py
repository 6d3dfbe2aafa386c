"""Lock-in of a dithered ring laser and its compensation."""
