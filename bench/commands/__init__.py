"""One file per command of the ``bench`` command line (docs/user-guide.md)."""
