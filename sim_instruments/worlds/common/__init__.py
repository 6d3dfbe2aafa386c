"""What the worlds share: the bench itself, heat, motion, wires, seeds."""
