"""Library of effects, one file each, by name."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points

from simulators.effects.base import Effect, EffectError

ENTRY_POINT_GROUP = "inertrim.effects"
_NOT_EFFECTS = {"base", "catalogue"}


@cache
def effects() -> dict[str, Effect]:
    """Return every known effect by name: the files of this folder and what other packages bring."""
    found = [
        import_module(f"{__name__}.{module.name}").EFFECT
        for module in pkgutil.iter_modules(__path__)
        if module.name not in _NOT_EFFECTS
    ]
    found += [point.load() for point in entry_points(group=ENTRY_POINT_GROUP)]
    return {effect.name: effect for effect in found}


def get_effect(name: str) -> Effect:
    """Return the effect of that name.

    Raises
    ------
    EffectError
        There is none.
    """
    if name not in effects():
        raise EffectError(f"no effect is named {name!r}; known are {', '.join(sorted(effects()))}")
    return effects()[name]
