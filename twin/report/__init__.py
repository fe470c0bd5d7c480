"""Reports of finished measurements, comparisons and studies: self-contained HTML pages and tables.

Most reports draw stored results and do not measure, so that they need no renderer. A page is data
(`twin.report.page`): sections of text, figures and tables (`twin.report.table`). The modules of
each kind of report are imported only when they are used, because importing all takes seconds.
"""

from twin.report.page import FIGURES_FOLDER, REPORT_FILE

__all__ = ["FIGURES_FOLDER", "REPORT_FILE", "REPORT_NAMES"]

REPORT_NAMES = (REPORT_FILE, FIGURES_FOLDER)
