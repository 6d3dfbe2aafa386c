"""What the VISA library remarks about a reply does not reach the terminal of a run."""

from __future__ import annotations

import subprocess
import sys

REMARK = """
import warnings, instruments.wire
for module in ("instruments.wire", "instruments.bus", "somewhere.else"):
    text = "read string doesn't end with termination characters"
    warnings.warn_explicit(text, UserWarning, module + ".py", 1, module=module)
"""


def test_a_reply_without_a_line_feed_is_no_warning_of_the_program() -> None:
    done = subprocess.run([sys.executable, "-c", REMARK], capture_output=True, text=True, check=True)
    assert done.stderr.count("UserWarning") == 1
    assert "somewhere.else" in done.stderr
