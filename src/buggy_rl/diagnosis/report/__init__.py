"""The HTML report of a diagnosis; the only part of the diagnosis that draws."""

from buggy_rl.diagnosis.report.page import Sheet, report, sheet_of

__all__ = ["Sheet", "report", "sheet_of"]
