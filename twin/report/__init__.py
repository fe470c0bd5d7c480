"""Reports of finished measurements, comparisons and studies: self-contained HTML pages and tables.

Reports draw stored results and do not measure, so no renderer is needed. A page is data
(`twin.report.page`): sections of text, figures and tables (`twin.report.table`). The modules of
each kind of report are imported where they are needed: importing all of them takes seconds.
"""

from twin.report.page import FIGURES_FOLDER, REPORT_FILE

__all__ = ["FIGURES_FOLDER", "REPORT_FILE", "REPORT_NAMES"]

REPORT_NAMES = (REPORT_FILE, FIGURES_FOLDER)
