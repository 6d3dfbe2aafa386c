"""How simulated instruments are reached: VISA, serial ports, messages."""
