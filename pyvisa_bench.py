"""PyVISA backend ``@bench``: PyVISA looks a backend up by this module name."""

from sim_instruments.bus.backend import BenchVisaLibrary as WRAPPER_CLASS  # noqa: N814 - the name PyVISA asks for

__all__ = ["WRAPPER_CLASS"]
