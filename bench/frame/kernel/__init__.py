"""The compiled engine: numba, in the modules that are loaded when it is asked for; ``arrays`` loads without it."""
