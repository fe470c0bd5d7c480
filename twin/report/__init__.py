"""Reports of finished measurements, comparisons and studies: self-contained HTML pages and tables.

Reports draw what result folders hold; nothing here measures, so no renderer is needed. A page is
data (`twin.report.page`): sections of text, figures and tables (`twin.report.table`).
"""

from twin.report.comparison import comparison_table, write_comparison
from twin.report.measurement import summary_table, write_report
from twin.report.page import FIGURES_FOLDER, REPORT_FILE

__all__ = [
    "REPORT_FILE",
    "REPORT_NAMES",
    "comparison_table",
    "summary_table",
    "write_comparison",
    "write_report",
]

REPORT_NAMES = (REPORT_FILE, FIGURES_FOLDER)
