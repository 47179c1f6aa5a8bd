"""Frame layouts by name: ours here, others' through the entry point group ``inertrim.protocols``.

A protocol of another package is a subclass of :class:`~drivers.protocols.base.Protocol` named by an entry point
of that group; it needs no change here.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import cast

from drivers.protocols.base import Protocol, ProtocolError

ENTRY_POINT_GROUP = "inertrim.protocols"
_BUILT_IN = {"native": "drivers.protocols.native:Native"}


def protocol_names() -> list[str]:
    """Return the names that :func:`get_protocol` knows, sorted."""
    return sorted({*_BUILT_IN, *(point.name for point in entry_points(group=ENTRY_POINT_GROUP))})


def get_protocol(name: str, **options: object) -> Protocol:
    """Return the protocol of that name, set up with its options.

    Raises
    ------
    ProtocolError
        No such protocol, or it has no such option, or the option's value is not legal.
    """
    kind = _find(name)
    try:
        return kind(**options)
    except TypeError:
        raise ProtocolError(f"protocol {name} does not take these options: {', '.join(sorted(options))}") from None


def _find(name: str) -> type[Protocol]:
    """Return the class that stands for a name."""
    if name in _BUILT_IN:
        module, _, attribute = _BUILT_IN[name].partition(":")
        return cast(type[Protocol], getattr(import_module(module), attribute))
    for point in entry_points(group=ENTRY_POINT_GROUP, name=name):
        return cast(type[Protocol], point.load())
    raise ProtocolError(f"no protocol named {name!r}; known are {', '.join(protocol_names())}")
