"""Reports of finished measurements: one self-contained HTML page and a short plain-text table.

Everything here reads result folders only; nothing renders, so no renderer is needed.
"""

from twin.report.page import write_report
from twin.report.table import summary_table

__all__ = ["summary_table", "write_report"]
