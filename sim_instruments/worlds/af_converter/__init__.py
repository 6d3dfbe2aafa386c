"""The AF converter and its bench."""
