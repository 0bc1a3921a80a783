"""The report of a training job: one HTML page that needs nothing else, for the screen and for paper."""

from training.report.page import check_report, report_path, write_report

__all__ = ["check_report", "report_path", "write_report"]
