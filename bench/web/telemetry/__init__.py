"""Runs for the programs of others: what a scraper reads of them, and what a broker of messages is told."""

from bench.web.telemetry.lookout import ENDED_S, FRESH_S, Lookout, SeenRun
from bench.web.telemetry.metrics import Scrapes, families
