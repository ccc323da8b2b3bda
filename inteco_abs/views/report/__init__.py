"""HTML report of one or more stops."""

from inteco_abs.views.report.page import check_report, report_page, report_path, write_report

__all__ = ["check_report", "report_page", "report_path", "write_report"]
