"""The shortest scale-factor campaign: what of one is free, what the rules keep, and how it is written.

Decision: docs/method-uncertainty.md.
"""
