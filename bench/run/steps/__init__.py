"""The kinds of steps as they are carried out, and the place of the run."""
