"""``python -m bench.run.guard``: started by a run, never by hand."""

import sys

from bench.model.errors import InstallationError
from bench.run.guard.process import main

try:
    sys.exit(main())
except InstallationError as error:  # the run that started it is told in one line
    sys.stderr.write(f"{error}\n")
    sys.exit(error.exit_status)
