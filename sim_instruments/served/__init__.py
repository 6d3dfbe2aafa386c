"""The simulated bench as a process of its own in real time."""
