"""Tests of the distribution, run with it installed: ``pip install -e .`` beside the bench."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
