"""Shared parts of the worlds: the bench itself, heat, motion, wires, seeds."""
