"""The report: one page that says what a recovery did, and shows it."""

from motionrecover.report.page import write_report

__all__ = ["write_report"]
