"""How large the gap is: whitened RMS by one noise model, navigation error, and a map of where it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idct

from inertial.documents import CHANNELS
from inertial.strapdown import navigate
from simulators.discrepancy.adopt import Search
from simulators.discrepancy.candidates import Slot
from simulators.discrepancy.compare import Scene
from simulators.discrepancy.evidence import Fit

Array = NDArray[np.float64]

NAVIGATED_S = (60.0, 300.0)
_SEGMENTS = 10


def rms(search: Search, slots: Sequence[Slot], fit: Fit) -> float:
    """Return the RMS of what a fit leaves, whitened by the final noise; noise alone gives 1."""
    squares = sum(float(np.sum(fit.rss[s] / search.fit.noise[s].power)) for s in slots)
    return float(np.sqrt(squares / max(sum(search.evidence.basis[s].n for s in slots), 1)))


def adopted_rates(search: Search, scene: int) -> Array:
    """Return what all that was adopted adds to a scene's readings, as analysed (n, 6) [y]."""
    library = search.evidence.library
    n = search.evidence.basis[scene, 0].n
    added = np.zeros((n, 6))
    for c in range(6):
        total = library.added((scene, c), search.fit.ids, search.fit.amplitude)
        added[:, c] = idct(total, norm="ortho") * library.spread[scene, c]
    return added


def navigation_gap(raw: Sequence[Scene], scenes: Sequence[Scene], search: Search) -> dict[str, dict[str, float | None]]:
    """Return the distance [m] between navigations from measured and predicted increments, before and after."""
    gap: dict[str, dict[str, float | None]] = {"before": {}, "after": {}}
    for name, scene, extra in (("before", raw[0], None), ("after", scenes[0], adopted_rates(search, 0))):
        group, interval = scene.group, scene.interval_s
        n = search.evidence.basis[0, 0].n
        measured = np.column_stack([scene.analysed(scene.measured[:, c], c) for c in range(6)])
        predicted = np.column_stack([scene.analysed(scene.predicted[:, c], c) for c in range(6)])
        if extra is not None:
            predicted = predicted + extra
        del group
        tracks = []
        for rates in (measured, predicted):
            steps = rates[:n] * interval
            track = navigate(
                steps[:, :3], steps[:, 3:], interval, scene.setup.C_tb, scene.setup.site, scene.setup.azimuth_rad
            )
            tracks.append(track.position_m)
        apart = np.linalg.norm(tracks[0] - tracks[1], axis=1)
        for span in NAVIGATED_S:
            place = round(span / interval)
            value = float(apart[place]) if place < len(apart) else None
            gap[name][f"{span:g}"] = value if value is None or np.isfinite(value) else None
    return gap


def where(search: Search) -> list[dict[str, Any]]:
    """Return, by channel and tenth of each recording, the whitened RMS before and after, and what went on."""
    table = []
    library = search.evidence.library
    for s, c in search.evidence.slots:
        scene = library.scenes[s]
        weight = search.evidence.basis[s, c].each(search.fit.noise[s, c].power ** -0.5)
        rows = {}
        for name, fit in (("before", search.bare), ("after", search.fit)):
            left = library.left((s, c), fit.ids, fit.amplitude)
            rows[name] = np.asarray(idct(weight * left, norm="ortho"))
        n = len(weight)
        edges = np.linspace(0, n, _SEGMENTS + 1).astype(int)
        for k in range(_SEGMENTS):
            span = slice(int(edges[k]), int(edges[k + 1]))
            time_s = scene.time_s[:: scene.group]
            begin, end = float(time_s[span.start]), float(time_s[min(span.stop, len(time_s) - 1)])
            table.append(
                {
                    "recording": s,
                    "channel": CHANNELS[c],
                    "start_s": begin,
                    "end_s": end,
                    "regime": _regime(scene, begin, end),
                    "temperature_c": float(np.mean(scene.seen.temperature_c[span, 0])) if scene.warm else None,
                    "before": float(np.sqrt(np.mean(rows["before"][span] ** 2))),
                    "after": float(np.sqrt(np.mean(rows["after"][span] ** 2))),
                }
            )
    return table


def _regime(scene: Scene, begin_s: float, end_s: float) -> str:
    kinds = {m.kind for m in scene.recording.meta.motion if m.start_s < end_s and m.end_s > begin_s}
    kinds.discard("rest")
    return "+".join(sorted(kinds)) or "rest"
