"""Options of protocols, which may come as text from a command line: read, or refused by name."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TypeVar

from drivers.protocols.base import ProtocolError

T = TypeVar("T", str, float)


def choice(name: str, value: object, legal: Iterable[T]) -> T:
    """Return the legal value that ``value`` says; numbers may be text, letters of either case.

    Raises
    ------
    ProtocolError
        It says none of them.
    """
    legal = list(legal)
    for one in legal:
        if str(value).lower() == str(one).lower() or _number(value) == one:
            return one
    shown = ", ".join(f"{one:g}" if isinstance(one, float) else one for one in legal)
    raise ProtocolError(f"option {name}={value} is not one of {shown}")


def positive(name: str, value: object) -> float | None:
    """Return a number above zero, or None where the option is not given.

    Raises
    ------
    ProtocolError
        It is no such number.
    """
    if value is None:
        return None
    number = _number(value)
    if number is None or not 0 < number < math.inf:
        raise ProtocolError(f"option {name}={value} is not a number above 0")
    return number


def switch(name: str, value: object) -> bool:
    """Return a yes or no.

    Raises
    ------
    ProtocolError
        It is neither.
    """
    return choice(name, {"yes": "true", "1": "true", "no": "false", "0": "false"}.get(str(value), value), _SWITCH) == (
        "true"
    )


_SWITCH = ("true", "false")


def _number(value: object) -> float | None:
    """Return the number that a value or its text is."""
    try:
        return float(str(value))
    except ValueError:
        return None
