"""True motion on the turning Earth, from the definitions: attitude a product of rotations, inputs by quadrature."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

EARTH_RATE_RADPS = 7.292115e-5
STANDARD_GRAVITY_MPS2 = 9.80665
_GAUSS_NODES = (0.5 - math.sqrt(3) / 6, 0.5 + math.sqrt(3) / 6)


@dataclass(frozen=True)
class Turn:
    """A turn as commanded, and how the table really made it."""

    start_s: float
    end_s: float
    rate_radps: float
    axis: tuple[float, float, float]
    frame: str
    angle_sigma_rad: float = 0.0
    angle_error_rad: float = 0.0
    start_shift_s: float = 0.0
    end_shift_s: float = 0.0


@dataclass(frozen=True)
class Shake:
    """Random vibration: flat acceleration spectrum in a band along a body axis, as a sum of tones of velocity."""

    start_s: float
    end_s: float
    axis: tuple[float, float, float]
    grms: float
    band_hz: tuple[float, float]
    frequency_hz: np.ndarray = field(repr=False)
    phase_rad: np.ndarray = field(repr=False)

    def speed(self, time_s: np.ndarray) -> np.ndarray:
        """Velocity [m/s] along the axis; swells and fades in a tenth of a second so that it starts and ends at rest."""
        speed = np.zeros(len(time_s))
        inside = np.flatnonzero((time_s > self.start_s) & (time_s < self.end_s))
        omega = 2 * np.pi * self.frequency_hz
        amplitude = self.grms * STANDARD_GRAVITY_MPS2 * math.sqrt(2 / len(omega)) / omega
        for chunk in np.array_split(inside, max(1, len(inside) // 2000)):
            t = time_s[chunk]
            envelope = np.clip(np.minimum(t - self.start_s, self.end_s - t) / 0.1, 0, 1)
            speed[chunk] = envelope * (np.cos(np.outer(t, omega) + self.phase_rad) @ amplitude)
        return speed


@dataclass(frozen=True)
class Setup:
    """How the block stands and what is done with it.

    Angles in rad; tilts are rotation vectors about tangent axes 1 and 2, of the room and riding with the block.
    """

    latitude: float
    gravity: float
    azimuth: float
    roll: float
    pitch: float
    heading: float
    turns: tuple[Turn, ...] = ()
    shakes: tuple[Shake, ...] = ()
    room_tilt: tuple[float, float] = (0.0, 0.0)
    block_tilt: tuple[float, float] = (0.0, 0.0)
    offset_s: float = 0.0

    def with_turn(self, number: int, **changes: float) -> Setup:
        """Return the same with one turn changed."""
        turns = list(self.turns)
        turns[number] = replace(turns[number], **changes)
        return replace(self, turns=tuple(turns))


def rodrigues(axis: np.ndarray, angle: np.ndarray | float) -> np.ndarray:
    """Rotation matrices (n, 3, 3) about a unit axis."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.atleast_1d(angle)[:, None, None]
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


def _tilted(tilt: tuple[float, float]) -> np.ndarray:
    angle = math.hypot(*tilt)
    return rodrigues(np.array([*tilt, 0.0]) / angle, angle)[0] if angle else np.eye(3)


def attitude_matrix(roll: float, pitch: float, heading: float) -> np.ndarray:
    """C_tb = Rz(-heading) Ry(-pitch) Rx(roll)."""
    z, y, x = np.eye(3)[[2, 1, 0]]
    return (rodrigues(z, -heading) @ rodrigues(y, -pitch) @ rodrigues(x, roll))[0]


def earth_rate(setup: Setup) -> np.ndarray:
    """Earth's rate in the tangent frame: axis 1 along the azimuth (clockwise from north), 2 to its left, 3 up."""
    north, up = math.cos(setup.latitude), math.sin(setup.latitude)
    return EARTH_RATE_RADPS * np.array([north * math.cos(setup.azimuth), north * math.sin(setup.azimuth), up])


def normal_gravity(latitude: float, height_m: float) -> float:
    """WGS-84 normal gravity [m/s²] with the height terms of TR8350.2."""
    a, f, m, s = 6378137.0, 1 / 298.257223563, 0.00344978650684, math.sin(latitude) ** 2
    surface = 9.7803253359 * (1 + 0.00193185265241 * s) / math.sqrt(1 - f * (2 - f) * s)
    return surface * (1 - 2 / a * (1 + f + m - 2 * f * s) * height_m + 3 * height_m**2 / a**2)


class Path:
    """Attitude and body rate at any time."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        C0 = attitude_matrix(setup.roll, setup.pitch, setup.heading)
        self.outside, self.inside = _tilted(setup.room_tilt), C0.T @ _tilted(setup.block_tilt) @ C0
        self.pieces = []  # start, rate, axis, frame, attitude at start
        start, C = -math.inf, C0
        for turn in setup.turns:
            begin = turn.start_s + turn.start_shift_s + setup.offset_s
            end = turn.end_s + turn.end_shift_s + setup.offset_s
            whole = turn.rate_radps * (turn.end_s - turn.start_s) + turn.angle_error_rad
            axis = np.array(turn.axis) / math.hypot(*turn.axis)
            self.pieces.append((start, 0.0, axis, "body", C))
            self.pieces.append((begin, whole / (end - begin), axis, turn.frame, C))
            R = rodrigues(axis, whole)[0]
            start, C = end, C @ R if turn.frame == "body" else R @ C
        self.pieces.append((start, 0.0, np.array([0.0, 0.0, 1.0]), "body", C))
        self.starts = np.array([piece[0] for piece in self.pieces])

    def at(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """True C_tb (n, 3, 3) and rate relative to the room in body axes (n, 3); times increase."""
        C, rate = np.empty((len(time_s), 3, 3)), np.zeros((len(time_s), 3))
        bounds = [*np.searchsorted(time_s, self.starts), len(time_s)]
        for (start, w, axis, frame, begin), low, high in zip(self.pieces, bounds[:-1], bounds[1:], strict=True):
            here = slice(low, high)
            if w == 0.0 or low == high:
                C[here] = self.outside @ begin @ self.inside
                continue
            R = rodrigues(axis, w * (time_s[here] - start))
            stated = begin @ R if frame == "body" else R @ begin
            rate[here] = (w * axis if frame == "body" else w * (axis @ stated)) @ self.inside
            C[here] = self.outside @ stated @ self.inside
        return C, rate


def increments(setup: Setup, edges_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return dv, dtheta (n, 3) over the intervals between edges, and the attitude at their middles (n, 3, 3)."""
    path = Path(setup)
    cuts = path.starts[(path.starts > edges_s[0]) & (path.starts < edges_s[-1])]
    fine = np.unique(np.concatenate([edges_s, cuts]))
    steps = np.diff(fine)
    spin = earth_rate(setup)
    dv, dtheta = np.zeros((len(steps), 3)), np.zeros((len(steps), 3))
    for node in _GAUSS_NODES:
        C, rate = path.at(fine[:-1] + node * steps)
        dv += 0.5 * steps[:, None] * setup.gravity * C[:, 2, :]
        dtheta += 0.5 * steps[:, None] * (np.einsum("j,njk->nk", spin, C) + rate)
    first = np.searchsorted(fine, edges_s[:-1])
    dv, dtheta = np.add.reduceat(dv, first), np.add.reduceat(dtheta, first)
    for shake in setup.shakes:
        dv += np.diff(shake.speed(edges_s))[:, None] * np.array(shake.axis) / math.hypot(*shake.axis)
    return dv, dtheta, path.at((edges_s[1:] + edges_s[:-1]) / 2)[0]


def add_sway(dv: np.ndarray, dtheta: np.ndarray, C: np.ndarray, psi: np.ndarray, gravity: float, dt: float) -> None:
    """Add small angles psi (n + 1, 3) [rad] of the mount about tangent axes, given at the interval's edges."""
    dtheta += np.einsum("nij,ni->nj", C, np.diff(psi, axis=0))
    middle = (psi[1:] + psi[:-1]) / 2
    dv -= np.einsum("nij,ni->nj", C, np.cross(middle, [0.0, 0.0, gravity])) * dt
