"""What is looked at while steps run: interlocks, temperatures, clocks, trend."""
