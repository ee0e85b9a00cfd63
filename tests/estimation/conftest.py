"""The short recordings that the tests of the diagnosis use too."""

from tests.diagnosis.conftest import drives, late

__all__ = ["drives", "late"]
