"""Scale factors by the multimeter instead of the calibrator."""
