"""``docs/effects.md`` from the effects' definitions: ``python -m simulators.effects.catalogue > docs/effects.md``."""

from __future__ import annotations

import inspect

from simulators.effects import effects
from simulators.effects.base import Effect, Stage

_HEAD = """# Which effects are known, and what does each do?

One file each in `simulators/effects/`; simulated and fitted from the same definition. This page is made from these
files by `python -m simulators.effects.catalogue > docs/effects.md`; change them, not it.

`y` stands for m/s^2 on an accelerometer and rad/s on a gyro. *True input* is the specific force or rate along the
sensor's axis, mean over a sample's interval; *temperature* is the first thermometer's; time is the device's. A sample
passes the stages in order: set-up (truth differs from what is stated), sensor (added), noise (added), readout, frame.
"""


def catalogue() -> str:
    """Return the page."""
    parts = [_HEAD, "| effect | what it is | on |", "|---|---|---|"]
    found = sorted(effects().values(), key=_order)
    parts += [f"| [`{effect.name}`](#{effect.name}) | {effect.text} | {_channels(effect)} |" for effect in found]
    return "\n".join(parts) + "\n" + "".join(_section(effect) for effect in found)


def _order(effect: Effect) -> tuple[int, str]:
    return int(effect.stage), effect.name


def _channels(effect: Effect) -> str:
    names = effect.channel_names()
    return ", ".join(names) if len(names) <= 4 else f"{names[0]} … {names[-1]}"


def _section(effect: Effect) -> str:
    lines = [
        f"\n## {effect.name}\n",
        f"{effect.text} {' '.join((inspect.getdoc(effect) or '').split())}\n",
        f"*Term:* {effect.term}. *Stage:* {Stage(effect.stage).name.lower()}. *On:* {_channels(effect)}. "
        f"*Best shown by:* {effect.shown_by}. *Magnitudes:* {effect.source}.\n",
    ]
    if effect.parameters:
        lines += ["| parameter | unit | what | typical, SI |", "|---|---|---|---|"]
    for parameter in effect.parameters:
        typical = "; ".join(
            f"{'' if kind == 'any' else kind + ' '}{span.low:g} to {span.high:g}"
            for kind, span in parameter.typical.items()
        )
        lines.append(f"| `{parameter.name}` | {parameter.unit} | {parameter.text} | {typical} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(catalogue(), end="")
