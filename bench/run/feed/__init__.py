"""The feed of a run: what it does, for whoever looks at it, from a memory of fixed size (docs/live-protocol.md)."""
