"""Samples for people to look at: a few values a second, with the extremes, so that no peak is hidden."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.samples import SampleArray, intervals_s


class Thinner:
    """Gathers samples and gives mean, lowest and highest of what came since the last time."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._parts: list[SampleArray] = []

    def clear(self) -> None:
        """Forget what was gathered."""
        self._parts = []

    def feed(self, samples: SampleArray) -> dict[str, Any] | None:
        """Take a batch; return the facts of ``samples`` events once ``every_s`` [block s] are full."""
        if self._parts and self._parts[0].dtype != samples.dtype:
            self.clear()
        self._parts.append(samples)
        if samples["time"][-1] - self._parts[0]["time"][0] < self._every_s:
            return None
        rows = np.concatenate(self._parts)
        self.clear()
        if len(rows) < 2 or np.any(np.diff(rows["time"]) <= 0):
            return None
        interval_s = intervals_s(rows)[:, None]
        accel, gyro, warmth = rows["dv"] / interval_s, rows["dtheta"] / interval_s, rows["temperature"]
        return {
            "time_s": float(rows["time"][-1]),
            "frames": len(rows),
            "accel_mps2": _extremes(accel),
            "gyro_radps": _extremes(gyro),
            "temperature_c": [None if np.isnan(one) else round(float(one), 3) for one in warmth[-1]],
        }


def _extremes(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, list[float]]:
    found = {"mean": values.mean(axis=0), "low": values.min(axis=0), "high": values.max(axis=0)}
    return {name: [float(one) for one in row] for name, row in found.items()}
