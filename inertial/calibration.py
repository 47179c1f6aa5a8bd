"""Laboratory calibration on a two-axis turntable: all coefficients of (1), (2) with their covariance.

For each rest, and for the gyros each turn, the mean of (1), (2) over the span must be what gravity, the Earth and the
table gave. About the ideal block (scale factors one, the rest zero) that is linear in the coefficients' deviations x
and in the nuisance errors η of the table (:mod:`inertial.turntable`)::

    A − ā = S⁺' ā⁺ + S⁻' ā⁻ + b + Σ (M⁺ ā_j⁺ + M⁻ ā_j⁻) − (∂A/∂η)·η + e              (1)
    G − ḡ = K⁺' ḡ⁺ + K⁻' ḡ⁻ + b̂ + Σ (N⁺ ḡ_j⁺ + N⁻ ḡ_j⁻) + Σ F_j ā_j − (∂G/∂η)·η + e  (2)

The regressors are means of the readings split sample by sample as sent, less what noise alone adds to both parts; what
is left in them is of the size of e, a few 10⁻⁶ of the range they are excited over, so that its square, the bias of
least squares with noisy regressors, vanishes. The estimator is the paper's square-root covariance filter; a batch
least squares over the same spans checks it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from inertial.documents import Calibration, ChannelNoise, Combination, Noise
from inertial.error_model import ACCELS, GYROS, Coefficients
from inertial.increments import Increments
from inertial.square_root_filter import SquareRootFilter, batch_least_squares
from inertial.standstill import learn_noise
from inertial.turntable import Span, TableSetup, Truth, spans_of, truth_of

Array = NDArray[np.float64]
Mounting = Mapping[str, Sequence[str]]
"""Which accelerometers act on which gyro, as ``{"gyro_x": ("accel_x", "accel_y"), …}``; empty for optical gyros."""

DTG_MOUNTING: Mounting = {
    "gyro_x": ("accel_x", "accel_y"),
    "gyro_y": ("accel_x", "accel_y"),
    "gyro_z": ("accel_x", "accel_z"),
}
"""Two DTGs, spin axes along z (measures x, y) and along y (measures z, x): a rotor answers to force across its spin."""

_FLICKER_FLOOR = 2.0 * math.log(2.0) / math.pi  # Allan variance of unit flicker: its mean strays by no less
_SETTLE_S = 1.0
_UNSEEN_SHARE = 0.5
_PASSES = 2  # the table's errors enter as angles: one pass to find them, one about what was found


@dataclass(frozen=True)
class CalibrationPrior:
    """1σ of what may be expected of any block, wide enough to leave everything to the data."""

    scale: float = 0.05
    misalignment: float = 0.05
    accel_bias_mps2: float = 1.0
    gyro_bias_radps: float = 0.02
    g_sensitivity_radps_per_mps2: float = 1e-3


@dataclass(frozen=True)
class TableRun:
    """One recording: the samples as sent and what the table was told to do."""

    window: Increments
    setup: TableSetup


@dataclass(frozen=True)
class Residual:
    """What one equation of one span leaves, in its unit [m/s², rad/s], and in units of the σ it should have."""

    run: int
    kind: str
    start_s: float
    channel: str
    residual: float
    normalised: float


@dataclass(frozen=True)
class CalibrationResult:
    """Coefficients of (1), (2) with covariance in ``order``, and how well the run agrees with them.

    ``nuisances`` are the table's errors found, name → (value, 1σ) [rad]; ``unobservable`` the combinations of
    coefficients that the run says less of than the prior; ``disagreement`` of filter and batch in σ, the largest,
    where there are two; ``refused`` the spans not used, with the reason;
    ``notes`` what else the data show.
    """

    method: str
    coefficients: Coefficients
    order: tuple[str, ...]
    values: Array
    covariance: Array
    nuisances: dict[str, tuple[float, float]]
    residuals: tuple[Residual, ...]
    chi_square: float
    degrees_of_freedom: int
    unobservable: tuple[Combination, ...]
    disagreement: float | None
    refused: tuple[str, ...]
    noise: Noise
    notes: tuple[str, ...] = ()

    @property
    def sigma(self) -> Array:
        """Return 1σ of each coefficient in ``order``."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def chi_square_probability(self) -> float:
        """Return how often so large a χ² comes by chance if the model holds; below 0.001 it does not."""
        return float(chdtrc(self.degrees_of_freedom, self.chi_square)) if self.degrees_of_freedom > 0 else 1.0

    def to_document(
        self,
        *,
        block: str = "",
        date: str = "",
        table_run: str = "",
        temperature_range_c: tuple[float, float] | None = None,
    ) -> Calibration:
        """Return ``calibration.json``."""
        return Calibration(
            block=block,
            date=date,
            method=self.method,
            table_run=table_run,
            temperature_range_c=temperature_range_c,
            coefficients=self.coefficients.to_document(),
            order=list(self.order),
            covariance=self.covariance.tolist(),
        )


def coefficient_names(mounting: Mounting) -> tuple[str, ...]:
    """Return the names of all coefficients of (1), (2), as paths in ``calibration.json``, channel by channel.

    Raises
    ------
    ValueError
        A mounting that names no gyro or no accelerometer.
    """
    for gyro, accels in mounting.items():
        if gyro not in GYROS or any(accel not in ACCELS for accel in accels):
            raise ValueError(f"mounting {gyro} ← {list(accels)} names no sensor; use gyro_x … and accel_x …")
    names = []
    for channels, bias in ((ACCELS, "bias_mps2"), (GYROS, "bias_radps")):
        for own in channels:
            names += [f"{own}.scale_positive", f"{own}.scale_negative", f"{own}.{bias}"]
            others = [name for name in channels if name != own]
            names += [f"{own}.misalignment_{sign}.{name}" for name in others for sign in ("positive", "negative")]
            names += [f"{own}.g_sensitivity_radps_per_mps2.{name}" for name in mounting.get(own, ())]
    return tuple(names)


def calibrate_table(
    runs: Sequence[TableRun],
    mounting: Mounting = DTG_MOUNTING,
    *,
    noise: Noise | None = None,
    prior: CalibrationPrior | None = None,
    settle_s: float = _SETTLE_S,
) -> CalibrationResult:
    """Estimate all coefficients of (1), (2) from one or more turntable runs.

    Parameters
    ----------
    noise
        Of the block; None: white noise as the rests show it.
    settle_s
        Left out of each rest beside a turn [s].

    Raises
    ------
    ValueError
        No usable rest, or a mounting that names no sensor.
    """
    names = coefficient_names(mounting)
    spans, refused, noise = _all_spans(runs, noise, settle_s)
    prior_sigma = prior_sigma_of(names, prior or CalibrationPrior())
    tables = [run.setup.nuisances() for run in runs]
    labels = [f"run {i + 1}: {name}" for i, (own, _) in enumerate(tables) for name in own]
    all_sigma = np.concatenate([prior_sigma, *(sigma for _, sigma in tables)])
    errors = [np.zeros(len(own)) for own, _ in tables]
    for _ in range(_PASSES):
        equations = equations_of(spans, runs, errors, names, noise)
        mean, covariance = filtered(equations, all_sigma)
        errors = np.split(mean[len(names) :], np.cumsum([len(own) for own, _ in tables])[:-1])
    checked, _ = batch_least_squares(equations.z, equations.H, equations.sigma, all_sigma)
    spread = np.sqrt(np.diag(covariance))
    known = spread > 0.0
    chi_square = _chi_square(equations, mean, all_sigma, len(names))
    own = covariance[: len(names), : len(names)]
    unobservable = unseen_combinations(names, own, prior_sigma)
    return CalibrationResult(
        method="two-axis turntable, square-root covariance filter",
        coefficients=coefficients_of(names, mean[: len(names)]),
        order=names,
        values=_absolute(names, mean[: len(names)]),
        covariance=own,
        nuisances={
            label: (float(value), float(sigma))
            for label, value, sigma, given in zip(
                labels, mean[len(names) :], spread[len(names) :], all_sigma[len(names) :], strict=True
            )
            if given > 0.0
        },
        residuals=_residuals(equations, mean, covariance),
        chi_square=chi_square,
        degrees_of_freedom=len(equations.z) - len(names) + len(unobservable),
        unobservable=unobservable,
        disagreement=float(np.max(np.abs(mean - checked)[known] / spread[known])),
        refused=refused,
        noise=noise,
    )


def _all_spans(
    runs: Sequence[TableRun], noise: Noise | None, settle_s: float
) -> tuple[list[list[Span]], tuple[str, ...], Noise]:
    """Return the spans of each run, what was refused, and the noise: given, or as the rests show it."""
    spans: list[list[Span]] = []
    refused: list[str] = []
    for i, run in enumerate(runs):
        window = run.window
        judge = noise or learn_noise(window.dv_mps, window.dtheta_rad, window.interval_s)
        found, left_out = spans_of(window, run.setup, judge, settle_s)
        spans.append(found)
        refused += [f"run {i + 1}: {text}" for text in left_out]
    rests = [span for found in spans for span in found if span.turn is None]
    if not rests:
        reasons = "; ".join(refused) or "no recording was given"
        raise ValueError(f"no rest to calibrate from: {reasons}")
    if noise is None:
        pairs = max(1, sum(span.pairs for span in rests))
        white = np.sqrt(np.sum([span.white_squares for span in rests], axis=0) / pairs)
        noise = Noise.model_validate(
            {name: ChannelNoise(white=float(w)) for name, w in zip((*ACCELS, *GYROS), white, strict=True)}
        )
    return spans, tuple(refused), noise


def prior_sigma_of(names: Sequence[str], prior: CalibrationPrior) -> Array:
    kinds = {
        "scale_positive": prior.scale,
        "scale_negative": prior.scale,
        "bias_mps2": prior.accel_bias_mps2,
        "bias_radps": prior.gyro_bias_radps,
        "misalignment_positive": prior.misalignment,
        "misalignment_negative": prior.misalignment,
        "g_sensitivity_radps_per_mps2": prior.g_sensitivity_radps_per_mps2,
    }
    return np.array([kinds[name.split(".")[1]] for name in names])


@dataclass(frozen=True)
class Equations:
    """``z = H·x + e``, 1σ of e; x: deviations of the coefficients, then nuisances. ``about`` names each row."""

    z: Array
    H: Array
    sigma: Array
    about: tuple[tuple[int, str, float, str], ...]


def equations_of(
    spans: list[list[Span]], runs: Sequence[TableRun], errors: Sequence[Array], names: Sequence[str], noise: Noise
) -> Equations:
    """Set up (1), (2) for all spans about the nuisance errors found so far."""
    z: list[float] = []
    rows: list[Array] = []
    sigma: list[float] = []
    about: list[tuple[int, str, float, str]] = []
    nuisances = sum(len(e) for e in errors)
    first = len(names)
    for i, (found, run, error) in enumerate(zip(spans, runs, errors, strict=True)):
        for span, truth in zip(found, truth_of(found, run.setup, error), strict=True):
            for channel, value, slope in _unknown_sides(span, truth):
                row = np.zeros(len(names) + nuisances)
                row[: len(names)] = regressor(names, channel, span)
                row[first : first + len(error)] = -slope
                z.append(value - float(slope @ error))
                rows.append(row)
                sigma.append(_mean_sigma(span.duration_s, getattr(noise, channel)))
                kind = "rest" if span.turn is None else f"turn {span.turn + 1}"
                about.append((i + 1, kind, span.start_s, channel))
        first += len(error)
    return Equations(np.array(z), np.array(rows), np.array(sigma), tuple(about))


def _unknown_sides(span: Span, truth: Truth) -> list[tuple[str, float, Array]]:
    """Return channel, truth − reading and ∂truth/∂η of a span; accelerometers only at rest."""
    accel, gyro = span.accel_positive + span.accel_negative, span.gyro_positive + span.gyro_negative
    sides: list[tuple[str, float, Array]] = []
    for j in range(3):
        if span.turn is None:
            sides.append((ACCELS[j], float(truth.A[j] - accel[j]), truth.dA[j]))
        sides.append((GYROS[j], float(truth.G[j] - gyro[j]), truth.dG[j]))
    return sides


def regressor(names: Sequence[str], channel: str, span: Span) -> Array:
    """Return the row (n,) of (1) or (2) that multiplies the coefficients' deviations, from mean split readings."""
    readings = {
        "positive": dict(zip((*ACCELS, *GYROS), (*span.accel_positive, *span.gyro_positive), strict=True)),
        "negative": dict(zip((*ACCELS, *GYROS), (*span.accel_negative, *span.gyro_negative), strict=True)),
    }
    row = np.zeros(len(names))
    for k, name in enumerate(names):
        own, kind, *other = name.split(".")
        if own != channel:
            continue
        if kind.startswith("bias"):
            row[k] = 1.0
        elif kind.startswith("g_sensitivity"):
            row[k] = readings["positive"][other[0]] + readings["negative"][other[0]]
        else:  # scale_positive, misalignment_negative, …
            row[k] = readings[kind.rpartition("_")[2]][other[0] if other else own]
    return row


def _mean_sigma(duration_s: float, channel: ChannelNoise) -> float:
    """Return 1σ of a mean over a time: white noise, flicker floor, random walk (IEEE 952 annex C)."""
    walk = channel.random_walk**2 * duration_s / 3.0
    return math.sqrt(channel.white**2 / duration_s + _FLICKER_FLOOR * channel.flicker**2 + walk)


def filtered(equations: Equations, prior_sigma: Array) -> tuple[Array, Array]:
    """Run the square-root filter over the equations, span by span; return mean and covariance."""
    estimator = SquareRootFilter(np.zeros(len(prior_sigma)), np.diag(prior_sigma))
    edges = [0, *(k for k in range(1, len(equations.z)) if equations.about[k][:3] != equations.about[k - 1][:3])]
    for begin, end in zip(edges, [*edges[1:], len(equations.z)], strict=True):
        rows = slice(begin, end)
        estimator.update(equations.z[rows], equations.H[rows], np.diag(equations.sigma[rows]))
    return estimator.mean, estimator.covariance


def _chi_square(equations: Equations, mean: Array, prior_sigma: Array, coefficients: int) -> float:
    """Return the misfit of the equations and of the nuisances, which are measurements of the table's makers."""
    whitened = (equations.z - equations.H @ mean) / equations.sigma
    nuisance, sigma = mean[coefficients:], prior_sigma[coefficients:]
    given = sigma > 0.0
    return float(whitened @ whitened + np.sum((nuisance[given] / sigma[given]) ** 2))


def _residuals(equations: Equations, mean: Array, covariance: Array) -> tuple[Residual, ...]:
    left = equations.z - equations.H @ mean
    explained = np.einsum("ij,jk,ik->i", equations.H, covariance, equations.H)
    expected = np.sqrt(np.maximum(equations.sigma**2 - explained, 1e-12 * equations.sigma**2))
    return tuple(
        Residual(run, kind, start, channel, float(value), float(value / size))
        for (run, kind, start, channel), value, size in zip(equations.about, left, expected, strict=True)
    )


def _absolute(names: Sequence[str], deviations: Array) -> Array:
    return np.asarray(deviations + np.array([1.0 if ".scale_" in name else 0.0 for name in names]))


def coefficients_of(names: Sequence[str], deviations: Array) -> Coefficients:
    """Return the coefficients whose deviations from the ideal block are given in this order."""
    accel = {"positive": np.eye(3), "negative": np.eye(3)}
    gyro = {"positive": np.eye(3), "negative": np.eye(3)}
    accel_bias, gyro_bias, g_sensitivity = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for name, value in zip(names, deviations, strict=True):
        own, kind, *other = name.split(".")
        matrices, channels, bias = (accel, ACCELS, accel_bias) if own in ACCELS else (gyro, GYROS, gyro_bias)
        i = [str(channel) for channel in channels].index(own)
        if kind.startswith("bias"):
            bias[i] = value
        elif kind.startswith("g_sensitivity"):
            g_sensitivity[i, [str(accel_name) for accel_name in ACCELS].index(other[0])] = value
        else:
            j = [str(channel) for channel in channels].index(other[0]) if other else i
            matrices[kind.rpartition("_")[2]][i, j] += value
    return Coefficients(
        accel["positive"],
        accel["negative"],
        accel_bias,
        gyro["positive"],
        gyro["negative"],
        gyro_bias,
        g_sensitivity,
    )


def unseen_combinations(names: Sequence[str], covariance: Array, prior_sigma: Array) -> tuple[Combination, ...]:
    """Return the directions of which the run says less than half a prior σ, each led by one coefficient, in words."""
    share, directions = np.linalg.eigh(covariance / np.outer(prior_sigma, prior_sigma))
    basis = directions[:, share > _UNSEEN_SHARE**2].T.copy()
    for i in range(len(basis)):  # echelon form: the fewest names in each sentence
        lead = int(np.argmax(np.abs(basis[i])))
        basis[i] /= basis[i, lead]
        for k in range(len(basis)):
            if k != i:
                basis[k] -= basis[k, lead] * basis[i]
    found = []
    for row in basis:
        weights = {names[k]: float(row[k] * prior_sigma[k]) for k in np.argsort(-np.abs(row)) if abs(row[k]) > 0.05}
        found.append(Combination(combination=weights, text=_in_words(list(weights))))
    return tuple(found)


def _in_words(members: list[str]) -> str:
    lead, *others = members
    seen = f"{lead} cannot be seen in this run"
    if others:
        seen = f"{lead} cannot be told from {', '.join(others)} in this run"
    return f"{seen}: {_remedy(lead)}"


def _remedy(name: str) -> str:
    own, kind, *other = name.split(".")
    sign = "negative" if kind.endswith("negative") else "positive"
    if kind.startswith("g_sensitivity"):
        return f"add rests with {other[0]} up and down"
    if own in ACCELS:
        up = "down" if sign == "negative" else "up"
        axis = other[0] if other else own
        if kind.startswith("bias"):
            return f"add rests with {own} level, up and down, and half way between"
        return f"add rests with {axis} pointing {up}, straight and half way"
    if kind.startswith("bias"):
        return "add rests at more attitudes"
    return f"add turns in the {sign} sense about {other[0] if other else own}"


def calibration_report(result: CalibrationResult) -> str:
    """Return the result as text: equation, numbers with σ, agreement, what was not seen and what not used."""
    lines = [
        f"Calibration: {result.method}",
        "True specific force A [m/s²] and rate G [rad/s] from readings a, g, each sample split by its sign:",
        "  A_x = S+ a_x+ + S- a_x- + b_x + M_xy+ a_y+ + M_xy- a_y- + M_xz+ a_z+ + M_xz- a_z-        (1)",
        "  G_x = K+ g_x+ + K- g_x- + b_x + N_xy+ g_y+ + N_xy- g_y- + N_xz+ g_z+ + N_xz- g_z- + F a  (2)",
        "",
        f"{'coefficient':<52}{'value':>18}{'1 sigma':>12}",
    ]
    for name, value, sigma in zip(result.order, result.values, result.sigma, strict=True):
        lines.append(f"{name:<52}{value:>18.9g}{sigma:>12.2g}")
    lines += [
        "",
        f"chi-square {result.chi_square:.1f} with {result.degrees_of_freedom} degrees of freedom "
        f"(chance of more: {result.chi_square_probability:.3g})",
    ]
    if result.disagreement is not None:
        lines.append(f"filter and batch least squares differ by {result.disagreement:.1e} sigma at most")
    if result.chi_square_probability < 0.001:
        lines.append(
            "the residuals are larger than noise and table explain: check the angles, their sigma and the rests"
        )
    if result.residuals:
        worst = max(result.residuals, key=lambda residual: abs(residual.normalised))
        lines.append(
            f"largest residual: {worst.channel} in {worst.kind} at {worst.start_s:.1f} s, {worst.normalised:+.2f} sigma"
        )
    lines += [f"not seen: {combination.text}" for combination in result.unobservable]
    lines += [f"not used: {text}" for text in result.refused]
    lines += [f"note: {text}" for text in result.notes]
    return "\n".join(lines) + "\n"
