"""The HTML report of a diagnosis; the only part of the diagnosis that draws."""

from buggy_rl.diagnosis.report.page import report

__all__ = ["report"]
