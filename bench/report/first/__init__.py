"""The first page of a report: who, what, when, where and how; the results that matter; what they mean."""

from bench.report.first.page import FirstPage, days_of, first_page
from bench.report.first.results import Block

__all__ = ["Block", "FirstPage", "days_of", "first_page"]
