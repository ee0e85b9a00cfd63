"""The page that shows a diagnosis to whoever drives the car; nothing else in here draws."""

from buggy_rl.diagnosis.report.page import report

__all__ = ["report"]
