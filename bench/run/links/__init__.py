"""The serial links of the unit: supervision, opening again, answers."""
