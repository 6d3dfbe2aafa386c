"""Ways to simulated instruments: VISA, serial ports, messages."""
