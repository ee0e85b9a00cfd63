"""Packages that the base installation leaves out, by the extra that installs them."""

from importlib import import_module
from typing import Any


class MissingExtraError(ImportError, ValueError):
    """A package of an extra is not installed; the message says which extra to install."""


def needs(package: str, extra: str, what: str) -> Any:
    """Imports a package of an extra.

    Args:
        package: Its name in Python.
        extra: The extra that installs it.
        what: Needs it, such as "reading a bag".

    Raises:
        MissingExtraError: It cannot be imported.
    """
    try:
        return import_module(package)
    except ImportError as error:
        reason = "" if isinstance(error, ModuleNotFoundError) else f" (it is there: {error})"
        raise MissingExtraError(
            f"{what} needs the package {package}{reason}: pip install 'buggy_rl[{extra}]'"
        ) from error
