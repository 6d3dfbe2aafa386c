"""All sessions ever recorded: where they are, whether they are whole, and what they would give today."""
