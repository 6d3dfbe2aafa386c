"""A lab folder with code of its own: the example of this repository, copied with rights that only its owner has."""

import os
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "lab_folder"
DRIVER, SIMULATOR, ANALYSIS = "instruments/example_t100.py", "sim_instruments/example_t100.py", "analyses/air_mean.py"
NAME = "20000101T000000Z_air_mean_R-1"


def copied(folder: Path) -> Path:
    """Return a copy of the example, whatever the rights of the checkout are and the umask of who runs the tests."""
    before = os.umask(0o022)
    try:
        for path in sorted(EXAMPLE.rglob("*")):
            if path.is_file() and path.suffix in {".py", ".yaml", ".toml"}:
                target = folder / path.relative_to(EXAMPLE)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(path.read_bytes())
    finally:
        os.umask(before)
    return folder
