"""The kinds of steps as they are carried out."""
