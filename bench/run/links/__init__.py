"""The serial links of the unit: acquisition, supervision, opening again."""
