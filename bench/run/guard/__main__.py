"""``python -m bench.run.guard``: started by a run, never by hand."""

import sys

from bench.run.guard.process import main

sys.exit(main())
