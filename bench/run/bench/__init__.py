"""Opening of the bench, its safe state, and the drill of that."""
