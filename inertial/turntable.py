"""A laboratory run on a two-axis turntable: where the block stood, how it turned, and what gravity and Earth gave it.

The inner axis is fixed in the block (``frame`` "body"), the outer one in the room ("tangent"). About either, the
turn's axis keeps its components in both frames while the block turns, so that the true angle a gyro triad gains is
the table's angle along one body axis plus the Earth's rotation, whatever the table's rate did on the way.

Unknown besides the coefficients are the levels and azimuth of the reference and the error of each turn's angle, each
with its own σ. A rest sees gravity and the Earth's rate through the attitude error ψ that they add up to::

    A = C_bt·g + C_bt·[g×]·ψ        G = C_bt·ω + C_bt·[ω×]·ψ        ψ = ε + Σ δ_j·u_j    (turns done)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from inertial.attitude import rotation_matrix, skew
from inertial.documents import ChannelNoise, Noise
from inertial.earth import Site
from inertial.increments import Increments
from inertial.standstill import still_spans

Array = NDArray[np.float64]
SHORTEST_REST_S = 3.0
_SECOND_S = 1.0


@dataclass(frozen=True)
class TableTurn:
    """A turn about one axis of the table by ``rate_radps·(end_s − start_s)`` in all, 1σ of that angle in rad."""

    start_s: float
    end_s: float
    rate_radps: float
    axis: tuple[float, float, float]
    frame: Literal["body", "tangent"]
    angle_sigma_rad: float = 0.0

    @property
    def angle_rad(self) -> float:
        """Return the angle turned."""
        return self.rate_radps * (self.end_s - self.start_s)

    @property
    def unit(self) -> Array:
        """Return the axis at length one."""
        return np.asarray(self.axis, dtype=np.float64) / np.linalg.norm(self.axis)


@dataclass(frozen=True)
class TableSetup:
    """How the block was mounted at time 0 and what the table then did.

    ``C_tb`` (3, 3) at time 0 in the tangent frame of ``azimuth_rad``. A level error with ``level_frame`` "tangent"
    belongs to the room (the table stands askew), with "body" it rides with the block (its fixture does).
    """

    site: Site
    azimuth_rad: float
    C_tb: Array
    turns: tuple[TableTurn, ...]
    level_sigma_rad: float = 0.0
    azimuth_sigma_rad: float = 0.0
    level_frame: Literal["tangent", "body"] = "tangent"

    def nuisances(self) -> tuple[list[str], Array]:
        """Return names and 1σ [rad] of the attitude errors: two levels, the azimuth, each turn's angle."""
        names = ["level 1", "level 2", "azimuth", *(f"turn {j + 1}" for j in range(len(self.turns)))]
        sigma = [self.level_sigma_rad] * 2 + [self.azimuth_sigma_rad]
        return names, np.array(sigma + [turn.angle_sigma_rad for turn in self.turns])


@dataclass(frozen=True)
class Span:
    """A rest (``turn`` None) or the turn of that number, with the means of the readings as sent.

    ``accel_positive`` … ``gyro_negative`` (3,): means of a⁺, a⁻ [m/s²], g⁺, g⁻ [rad/s] over ``duration_s``;
    ``progress_rad`` (n,), ``interval_s`` (n,): of a turn, how far it had got at the middle of each sample; of a rest,
    ``white_squares`` (6,): sum of the squared white noise densities that its ``pairs`` of neighbouring seconds show.
    """

    start_s: float
    duration_s: float
    turn: int | None
    done: int
    accel_positive: Array
    accel_negative: Array
    gyro_positive: Array
    gyro_negative: Array
    progress_rad: Array = field(default_factory=lambda: np.zeros(0))
    interval_s: Array = field(default_factory=lambda: np.zeros(0))
    white_squares: Array = field(default_factory=lambda: np.zeros(6))
    pairs: int = 0


@dataclass(frozen=True)
class Truth:
    """True means of a span, ``A`` (3,) [m/s²], ``G`` (3,) [rad/s], and their rows (3, k) by nuisance, per rad.

    During a turn ``A`` is that at its start: the accelerometers are not calibrated while they swing.
    """

    A: Array
    G: Array
    dA: Array
    dG: Array


def spans_of(window: Increments, setup: TableSetup, noise: Noise, settle_s: float) -> tuple[list[Span], list[str]]:
    """Cut a run into rests and turns, and name what cannot be used with the reason.

    Parameters
    ----------
    window
        The whole run; device time as in ``setup``.
    noise
        White noise per channel: what a reading at rest straggles by is judged with it, and removed from the sign split.
    settle_s
        Left out after and before each turn; given to the turn, so that all of its angle is in it.
    """
    times = window.start_s + np.cumsum(window.interval_s)
    spans: list[Span] = []
    refused: list[str] = []
    edges = [window.start_s, *(t for turn in setup.turns for t in (turn.start_s, turn.end_s)), float(times[-1])]
    for j, (start, end) in enumerate(zip(edges[0::2], edges[1::2], strict=True)):
        begin, stop = start + settle_s * (j > 0), end - settle_s * (j < len(setup.turns))
        part = _between(window, times, begin, stop)
        if part is None or part.duration_s < SHORTEST_REST_S:
            pass  # a pause between two turns
        elif (still := _longest_still(part, noise)) is None:
            refused.append(f"rest from {start:.1f} s to {end:.1f} s: the block moved")
        else:
            spans.append(_rest(still, j, noise))
        if j == len(setup.turns):
            break
        turn = setup.turns[j]
        whole = _between(window, times, turn.start_s - settle_s, turn.end_s + settle_s)
        if whole is None or whole.duration_s < turn.end_s - turn.start_s:
            refused.append(f"turn {j + 1} from {turn.start_s:.1f} s: the recording does not hold all of it")
        elif whole.repaired:
            refused.append(f"turn {j + 1} from {turn.start_s:.1f} s: samples were lost, and with them its angle")
        else:
            spans.append(_turned(whole, j, setup, noise))
    return spans, refused


def _between(window: Increments, times: Array, start_s: float, end_s: float) -> Increments | None:
    """Return the samples that lie wholly within a span."""
    first = int(np.searchsorted(times - window.interval_s, start_s - 1e-9))
    last = int(np.searchsorted(times, end_s + 1e-9, "right"))
    if last <= first:
        return None
    rows = slice(first, last)
    begin = float(times[first] - window.interval_s[first])
    return Increments(begin, window.dv_mps[rows], window.dtheta_rad[rows], window.interval_s[rows])


def _longest_still(part: Increments, noise: Noise) -> Increments | None:
    times = part.start_s + np.cumsum(part.interval_s)
    still = still_spans(times, part.dv_mps, part.dtheta_rad, part.interval_s, noise)
    longest = max(still, key=lambda span: span[1] - span[0], default=(0.0, 0.0))
    return _between(part, times, *longest) if longest[1] - longest[0] >= SHORTEST_REST_S else None


def _rest(part: Increments, done: int, noise: Noise) -> Span:
    """Return a rest with its means and the white noise in it: half the squared differences of 1 s means."""
    second = np.floor((np.cumsum(part.interval_s) - 0.5 * part.interval_s) / _SECOND_S).astype(np.int64)
    seconds = int(second[-1])  # the last may be cut
    sums = np.array([np.bincount(second, column)[:seconds] for column in (*part.dv_mps.T, *part.dtheta_rad.T)])
    means = sums / np.bincount(second, part.interval_s)[:seconds]
    squares = 0.5 * _SECOND_S * np.sum(np.diff(means, axis=1) ** 2, axis=1)
    split = _split_means(part, noise)
    return Span(part.start_s, part.duration_s, None, done, *split, white_squares=squares, pairs=seconds - 1)


def _turned(part: Increments, number: int, setup: TableSetup, noise: Noise) -> Span:
    """Return a turn with its progress as the gyro along its axis saw it, stretched to the table's angle."""
    turn = setup.turns[number]
    before = attitudes(setup, np.zeros(len(setup.turns)))[number]
    axis = turn.unit if turn.frame == "body" else before.T @ turn.unit
    earth = float(axis @ before.T @ setup.site.earth_rate_radps(setup.azimuth_rad))
    steps = part.dtheta_rad @ axis - earth * part.interval_s
    reached = np.cumsum(steps)
    progress = (reached - 0.5 * steps) * (turn.angle_rad / reached[-1])
    return Span(part.start_s, part.duration_s, number, number, *_split_means(part, noise), progress, part.interval_s)


def _split_means(part: Increments, noise: Noise) -> tuple[Array, Array, Array, Array]:
    """Return the means of a⁺, a⁻, g⁺, g⁻ as sent, less what noise alone puts into both.

    Where a reading swings through zero by its own noise, the mean of its positive part is too great by
    ``r = σφ(m/σ) − |m|Φ(−|m|/σ)`` (m the mean, σ the noise of one sample), that of its negative part too small by as
    much; with S⁺ ≠ S⁻ it would go into the bias. During a turn the rate is far from zero or nearly none.
    """
    dt = part.interval_s[:, None]
    means: list[Array] = []
    for values, names in ((part.dv_mps, ("accel_x", "accel_y", "accel_z")), (part.dtheta_rad, _GYROS)):
        positive = np.maximum(values, 0.0).sum(axis=0) / part.duration_s
        negative = np.minimum(values, 0.0).sum(axis=0) / part.duration_s
        white = np.array([_channel(noise, name).white for name in names])
        excess = _rectified(positive + negative, white / np.sqrt(np.mean(dt)))
        excess = np.minimum(excess, np.minimum(positive, -negative))  # a reading that never crossed zero was not split
        means += [positive - excess, negative + excess]
    return means[0], means[1], means[2], means[3]


_GYROS = ("gyro_x", "gyro_y", "gyro_z")


def _channel(noise: Noise, name: str) -> ChannelNoise:
    channel: ChannelNoise = getattr(noise, name)
    return channel


def _rectified(mean: Array, sigma: Array) -> Array:
    size = np.abs(mean)
    ratio = size / np.maximum(sigma, 1e-300)
    return np.asarray(
        sigma * np.exp(-0.5 * np.minimum(ratio, 40.0) ** 2) / np.sqrt(2.0 * np.pi)
        - size * ndtr(-np.minimum(ratio, 40.0))
    )


def attitudes(setup: TableSetup, angle_errors_rad: Array) -> list[Array]:
    """Return C_tb before each turn and after the last, the turns' angles off by ``angle_errors_rad`` (turns,)."""
    found = [setup.C_tb]
    for turn, error in zip(setup.turns, angle_errors_rad, strict=True):
        rotation = rotation_matrix(turn.unit * (turn.angle_rad + error))
        found.append(found[-1] @ rotation if turn.frame == "body" else rotation @ found[-1])
    return found


def truth_of(spans: list[Span], setup: TableSetup, errors_rad: Array) -> list[Truth]:
    """Return what each span must have read with these nuisance errors (3 + turns,), and how it varies with them.

    An error of the room's frame turns gravity, the Earth's rate and the outer axis alike; one that rides with the
    block turns everything in body axes, the inner axis too.
    """
    level, azimuth = np.append(errors_rad[:2], 0.0), np.array([0.0, 0.0, errors_rad[2]])
    rides = setup.level_frame == "body"
    room = rotation_matrix(azimuth if rides else azimuth + level)
    case = rotation_matrix(setup.C_tb.T @ level) if rides else np.eye(3)
    gravity = room.T @ np.array([0.0, 0.0, setup.site.gravity_mps2])
    earth = room.T @ setup.site.earth_rate_radps(setup.azimuth_rad)
    C = attitudes(setup, errors_rad[3:])
    axes = [C[j] @ turn.unit if turn.frame == "body" else turn.unit for j, turn in enumerate(setup.turns)]
    directions = _error_directions(setup, C, axes)
    found = []
    for span in spans:
        C_bt = C[span.done].T
        columns = np.zeros((3, len(errors_rad)))
        columns[:, :3] = np.diag([not rides, not rides, True])
        columns[:, 3 : 3 + span.done] = directions[span.done]
        A, dA = C_bt @ gravity, C_bt @ skew(gravity) @ columns
        if span.turn is None:
            G, dG = C_bt @ earth, C_bt @ skew(earth) @ columns
        else:
            axis = C_bt @ axes[span.turn]
            mean_C_bt = _mean_rotation(axis, span) @ C_bt
            angle = setup.turns[span.turn].angle_rad + errors_rad[3 + span.turn]
            G, dG = axis * angle / span.duration_s + mean_C_bt @ earth, mean_C_bt @ skew(earth) @ columns
            dG[:, 3 + span.turn] = axis / span.duration_s
            if (
                setup.turns[span.turn].frame == "tangent"
            ):  # how far the inner axis has turned decides where the outer is
                swing = C_bt @ skew(axes[span.turn]) * (angle / span.duration_s)
                dG[:, 3 : 3 + span.done] += swing @ columns[:, 3 : 3 + span.done]
        A, G, dA, dG = case.T @ A, case.T @ G, case.T @ dA, case.T @ dG
        if rides:
            dA[:, :2], dG[:, :2] = (skew(A) @ setup.C_tb.T)[:, :2], (skew(G) @ setup.C_tb.T)[:, :2]
        found.append(Truth(A, G, dA, dG))
    return found


def _error_directions(setup: TableSetup, C: list[Array], axes: list[Array]) -> list[Array]:
    """Return, before each turn and after the last, the directions u (3, turns done) of the angle errors done so far.

    An outer turn takes the errors made before it along; an inner one, beneath them, does not.
    """
    found = [np.zeros((3, 0))]
    for j, turn in enumerate(setup.turns):
        earlier = C[j + 1] @ C[j].T @ found[-1] if turn.frame == "tangent" else found[-1]
        found.append(np.column_stack([earlier, axes[j]]))
    return found


def _mean_rotation(axis: Array, span: Span) -> Array:
    """Return the mean of R(axis, −progress) (3, 3) over a turn, by Rodrigues' formula summed."""
    weight = span.interval_s / span.duration_s
    cosine, sine = float(weight @ np.cos(span.progress_rad)), float(weight @ np.sin(span.progress_rad))
    along = np.outer(axis, axis)
    return np.asarray(along + cosine * (np.eye(3) - along) - sine * skew(axis))
