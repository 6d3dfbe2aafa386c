"""``python -m bench`` is the ``bench`` command; in a lab folder nothing is imported from where it was started."""

import os
import sys


def _lies_in_lab(folder: str) -> bool:
    """Return whether a folder is a lab folder or lies in one.

    Modules that the interpreter has loaded at its start are used and no others: those could be of the folder itself.
    """
    above, toml = os.path.dirname(folder), os.path.join(folder, "bench.toml")  # noqa: PTH118, PTH120
    return os.path.isfile(toml) or (above != folder and _lies_in_lab(above))  # noqa: PTH113


if __name__ == "__main__":
    if not sys.flags.safe_path and _lies_in_lab(sys.path[0]):
        del sys.path[0]
    from bench.cli import main

    main()
