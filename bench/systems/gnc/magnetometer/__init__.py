"""Zero, gain and angle of the magnetometer; hard and soft iron."""
