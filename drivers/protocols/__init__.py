"""Frame layouts by name: ours here, others' through the entry point group ``inertrim.protocols``.

A protocol of another package is a subclass of :class:`~drivers.protocols.base.Protocol` named by an entry point
of that group; it needs no change here.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from inspect import Parameter, signature
from typing import cast

from drivers.protocols.base import Protocol, ProtocolError

ENTRY_POINT_GROUP = "inertrim.protocols"
_BUILT_IN = {
    "hg4930": "drivers.protocols.hg4930:Hg4930",
    "kvh1750": "drivers.protocols.kvh1750:Kvh1750",
    "mip": "drivers.protocols.mip:Mip",
    "native": "drivers.protocols.native:Native",
    "novatel": "drivers.protocols.novatel:NovAtel",
    "stim300": "drivers.protocols.stim300:Stim300",
    "vectornav": "drivers.protocols.vectornav:VectorNav",
    "xsens": "drivers.protocols.xsens:Xsens",
}


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
    known = option_names(name)
    if unknown := sorted(set(options) - set(known)):
        takes = f"it knows {', '.join(known)}" if known else "it has none"
        raise ProtocolError(f"protocol {name} has no option {', '.join(unknown)}; {takes}")
    return kind(**options)


def option_names(name: str) -> list[str]:
    """Return the names of a protocol's options, in its own order.

    Raises
    ------
    ProtocolError
        No such protocol.
    """
    parameters = signature(_find(name)).parameters.values()
    return [one.name for one in parameters if one.kind in (Parameter.KEYWORD_ONLY, Parameter.POSITIONAL_OR_KEYWORD)]


def _find(name: str) -> type[Protocol]:
    """Return the class that stands for a name."""
    if name in _BUILT_IN:
        module, _, attribute = _BUILT_IN[name].partition(":")
        return cast(type[Protocol], getattr(import_module(module), attribute))
    for point in entry_points(group=ENTRY_POINT_GROUP, name=name):
        return _load(point)
    raise ProtocolError(f"no protocol named {name!r}; known are {', '.join(protocol_names())}")


def _load(point: EntryPoint) -> type[Protocol]:
    """Return the protocol that another package brings."""
    package = point.dist.name if point.dist is not None else "of unknown name"
    try:
        found = point.load()
    except Exception as error:  # another's module may fail in any way
        raise ProtocolError(
            f"protocol {point.name}: package {package} names it as {point.value}, which does not load: "
            f"{type(error).__name__}: {error}. Update or remove that package."
        ) from error
    if not (isinstance(found, type) and issubclass(found, Protocol)):
        raise ProtocolError(
            f"protocol {point.name}: {point.value} of package {package} is no subclass of "
            "drivers.protocols.base.Protocol. Update or remove that package."
        )
    return found
