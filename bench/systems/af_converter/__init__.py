"""AF-converter calibration: scale factor, bias ramp, multimeter method, recorded ramps of other systems."""
