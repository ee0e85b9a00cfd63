"""The HTML report of a diagnosis; the only part of the diagnosis that draws."""

from buggy_rl.diagnosis.report.page import report
from buggy_rl.diagnosis.report.sheet import Sheet, sheet_of

__all__ = ["Sheet", "report", "sheet_of"]
