"""A stop, or several beside one another, as a page for the browser."""

from inteco_abs.views.report.page import check_report, report_page, write_report

__all__ = ["check_report", "report_page", "write_report"]
