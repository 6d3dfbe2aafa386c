"""Draw the two pictures of the README from a real run: the live page of a session, and the first page of its report.

Run by ``make pictures``. Needs Chromium; everything shown comes from a run on the simulated bench.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from browser_rig import PageServer, chromium, visiting

HERE = Path(__file__).resolve().parent
SEQUENCE, SEED = "scale_factor_38h", 1
PAGE = {"width": 1360, "height": 860}
REPORT = {"width": 860, "height": 860}
DRAWN_MS = 4000


def main() -> None:
    """Run the campaign, look at it in a browser, and keep two small files."""
    with tempfile.TemporaryDirectory() as place, chromium() as browser:
        server = PageServer(Path(place))
        try:
            words = ["run", SEQUENCE, "--clock", "virtual", "--seed", str(SEED), "--out", str(server.out)]
            subprocess.run([sys.executable, "-m", "bench", *words], check=True)
            session = next(path for path in server.out.iterdir() if path.is_dir() and SEQUENCE in path.name)
            with visiting(browser, server, "viewer", viewport=PAGE, color_scheme="light") as visitor:
                page = visitor.open_run(session.name)
                page.wait_for_timeout(DRAWN_MS)
                page.screenshot(path=HERE / "live-page.png")
            report = browser.new_page(viewport=REPORT)
            report.goto((session / "report.html").as_uri())
            report.screenshot(path=HERE / "report.png")
        finally:
            server.end()


if __name__ == "__main__":
    main()
