"""Reports of finished measurements: one self-contained HTML page and a short plain-text table.

Everything here reads result folders only; nothing renders, so no renderer is needed.
"""

from twin.report.comparison import write_comparison
from twin.report.html import FIGURES_FOLDER
from twin.report.page import REPORT_FILE, write_report
from twin.report.summary import summary_table
from twin.report.table import comparison_table

__all__ = [
    "REPORT_FILE",
    "REPORT_NAMES",
    "comparison_table",
    "summary_table",
    "write_comparison",
    "write_report",
]

REPORT_NAMES = (REPORT_FILE, FIGURES_FOLDER)
