"""An interactive report of an answer: one HTML file that needs nothing beside it."""

from synchronizar.reporting.report.file import REPORT, write_report

__all__ = ["REPORT", "write_report"]
