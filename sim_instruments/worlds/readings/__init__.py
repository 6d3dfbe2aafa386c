"""A bench that reads a plain unit: a regulated rail, a monitor output and a thermistor, at meters by their roles."""
