"""Simulated instruments, the simulated unit under test and the world that wires them.

Nothing of ``bench`` imports this package statically; a simulated station names it (docs/decisions/0003).
"""

__bench__ = "inertial-bench"
