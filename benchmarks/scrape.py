"""What a scraper costs the page server: processor for ten scrapes a second of one living run, and for none.

The run, its 20 signals and the server (``bench serve``, a process of its own) are those of ``benchmarks.page``; nobody
looks at a page. Processor is that of /proc/<pid>/stat of the server alone: a connection that is kept, as Prometheus
keeps it, asked with the viewer's token each 0.1 s by the clock.

Measured on a quiet machine (python -m benchmarks.scrape 60): none 0.05 % of a core, ten a second 0.92, 0.95 and
0.97 % in three runs. A second of it: one look at the run, 0.3 %; ten requests that find everything cold, 0.65 %. Over
20 s, in which one fit of the run is begun as in every minute, it was 0.92 to 1.10 % in eleven runs.

Run: python -m benchmarks.scrape [SECONDS [SCRAPES A SECOND]]
"""

from __future__ import annotations

import sys
from http.client import HTTPConnection

from bench.model.clock import NS, Clock, WallClock
from benchmarks.page import Server, serving

ACCEPT = "application/openmetrics-text;version=1.0.0;q=0.5,text/plain;version=0.0.4;q=0.2,*/*;q=0.1"


def share(server: Server, clock: Clock, seconds: float, rate_Hz: float) -> str:
    """Return the processor share of the server while it is asked so often."""
    connection = HTTPConnection("127.0.0.1", server.port)
    before_s, begun_ns, answers, size = server.cpu_s(), clock.now_ns(), 0, 0
    while (clock.now_ns() - begun_ns) / NS < seconds:
        if rate_Hz:
            connection.request("GET", "/metrics", headers={**server.bearer, "Accept": ACCEPT})
            answers, size = answers + 1, len(connection.getresponse().read())
        due_s = answers / rate_Hz if rate_Hz else seconds
        clock.sleep(max(0.0, due_s - (clock.now_ns() - begun_ns) / NS))
    lasted_s = (clock.now_ns() - begun_ns) / NS
    connection.close()
    used = 100 * (server.cpu_s() - before_s) / lasted_s
    return f"{answers / lasted_s:.1f} scrapes/s of {size} bytes: {used:.2f} % of a core over {lasted_s:.0f} s"


def main(words: list[str]) -> int:
    """Print the figures."""
    seconds = float(words[0]) if words else 30.0
    rate_Hz = float(words[1]) if len(words) > 1 else 10.0
    clock = WallClock()
    with serving(clock) as server:
        for asked_Hz in (0.0, rate_Hz):
            sys.stdout.write(share(server, clock, seconds, asked_Hz) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
