"""Matrices of gyroscopes and accelerometers on the turntable."""
