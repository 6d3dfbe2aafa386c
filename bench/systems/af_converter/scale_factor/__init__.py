"""Scale factors of all channels at all temperatures."""
