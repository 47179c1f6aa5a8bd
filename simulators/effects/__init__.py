"""Library of effects, one file each, by name."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from simulators.effects.base import Effect, EffectError

ENTRY_POINT_GROUP = "inertrim.effects"
_NOT_EFFECTS = {"base", "catalogue"}


@cache
def effects() -> dict[str, Effect]:
    """Return every known effect by name: the files of this folder and what other packages bring.

    Raises
    ------
    EffectError
        Another package names an effect that does not load.
    """
    found = [
        import_module(f"{__name__}.{module.name}").EFFECT
        for module in pkgutil.iter_modules(__path__)
        if module.name not in _NOT_EFFECTS
    ]
    found += [_load(point) for point in entry_points(group=ENTRY_POINT_GROUP)]
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


def _load(point: EntryPoint) -> Effect:
    """Return the effect that another package brings."""
    package = point.dist.name if point.dist is not None else "of unknown name"
    try:
        found = point.load()
    except Exception as error:  # another's module may fail in any way
        raise EffectError(
            f"effect {point.name}: package {package} names it as {point.value}, which does not load: "
            f"{type(error).__name__}: {error}. Update or remove that package."
        ) from error
    if not isinstance(found, Effect):
        raise EffectError(
            f"effect {point.name}: {point.value} of package {package} is no simulators.effects.base.Effect. "
            "Update or remove that package."
        )
    return found
