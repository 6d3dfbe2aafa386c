"""The guard: a small process of its own that brings the bench to its safe state when the controller cannot."""
