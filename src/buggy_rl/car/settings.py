"""Sections of a config file -> NamedTuples; every error names key, value and what is expected."""

import math
from typing import Any, Dict, Mapping, Tuple, Type, TypeVar, Union

Section = TypeVar("Section", bound=tuple)
Allowed = Union[Tuple[float, float], Tuple[str, ...]]
"""A closed range of numbers, or the words to choose from."""


def section(
    kind: Type[Section],
    content: Mapping[str, Any],
    place: str,
    allowed: Mapping[str, Allowed] = {},
) -> Section:
    """A NamedTuple of a mapping; absent keys keep their defaults.

    Args:
        kind: A NamedTuple class; its defaults say the type of each value.
        content: Keys and values, as of JSON.
        place: What messages call the section, e.g. `safety`.
        allowed: Field -> range or words.

    Raises:
        ValueError: A key is unknown or missing, or a value has a wrong type or range.
    """
    fields, defaults = kind._fields, kind._field_defaults  # type: ignore[attr-defined]
    if not isinstance(content, Mapping):
        raise ValueError(f"{place}={content!r}: must be an object with keys and values")
    for key in content:
        if key not in fields:
            known = ", ".join(fields)
            raise ValueError(f"{place}.{key}: unknown key; available: {known}")
    for key in fields:
        if key not in content and key not in defaults:
            raise ValueError(f"{place}.{key} is missing; state it")
    values: Dict[str, Any] = {}
    for key, value in content.items():
        values[key] = _checked(value, defaults.get(key), place + "." + key, allowed.get(key))
    return kind(**values)


def _checked(value: Any, default: Any, name: str, allowed: Any) -> Any:
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{name}={value!r}: must be true or false")
        return value
    if isinstance(default, (int, float)):
        value = _number(value, default, name)
    if isinstance(default, str) and not isinstance(value, str):
        raise ValueError(f"{name}={value!r}: must be a text")
    if allowed is None:
        return value
    if isinstance(allowed[0], str):
        if value not in allowed:
            raise ValueError("{}={!r}: must be one of {}".format(name, value, ", ".join(allowed)))
    elif not allowed[0] <= value <= allowed[1]:
        raise ValueError(f"{name}={value!r}: must be in [{allowed[0]:g}, {allowed[1]:g}]")
    return value


def _number(value: Any, default: Any, name: str) -> Any:
    whole = isinstance(default, int)
    right = isinstance(value, int if whole else (int, float)) and not isinstance(value, bool)
    if not right or not math.isfinite(value):
        what = "whole number" if whole else "finite number"
        raise ValueError(f"{name}={value!r}: must be a {what}")
    return value if whole else float(value)
