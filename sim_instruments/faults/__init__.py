"""What can go wrong on a simulated bench."""
