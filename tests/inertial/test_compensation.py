"""The paper's chain: its closed forms, its Table 3, its covariance by Monte Carlo, a real ring-laser block.

Truth is made here by closed form: at rest each sensor reads gravity or Earth rate in body axes less its term.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.stats import chi2

from inertial.alignment import Alignment, Reference, coarse_alignment
from inertial.attitude import body_to_tangent, rotation_matrix
from inertial.compensation import ChainResult, paper_chain, paper_stage, slopes_of_nodes
from inertial.documents import ChannelNoise, Noise
from inertial.earth import Site
from inertial.error_model import Coefficients, Terms, readings_from_true
from inertial.increments import Increments, increments_of
from inertial.noise import noise_of_block
from inertial.strapdown import navigate

Array = NDArray[np.float64]
MG, DEG_H = 9.80665e-3, math.radians(1.0) / 3600.0
SITE = Site.at(math.radians(35.7), 1200.0)
AZIMUTH = math.radians(40.0)
FORCE, RATE = np.array([0.0, 0.0, SITE.gravity_mps2]), SITE.earth_rate_radps(AZIMUTH)
IDEAL = Coefficients.ideal()
SILENT = Noise()
LEVEL = np.eye(3)
TILTED = body_to_tangent(0.1, 0.4, 2.0)


def aligned(C_tb: Array, level_sigma: float = 0.0, azimuth_sigma: float = 0.0) -> Alignment:
    return Alignment(C_tb, AZIMUTH, level_sigma, azimuth_sigma, "given", "given")


def rest(
    start_s: float,
    planted: Terms,
    *,
    C_tb: Array = LEVEL,
    duration_s: float = 60.0,
    interval_s: float = 0.1,
    noise: Array | None = None,
    coefficients: Coefficients = IDEAL,
) -> Increments:
    """Readings of a block at rest whose shift ``planted`` undoes; ``noise`` (n, 6) is added as rates."""
    count = round(duration_s / interval_s)
    truth = np.tile(np.concatenate([C_tb.T @ FORCE - planted.f_mps2, C_tb.T @ RATE - planted.g_radps]), (count, 1))
    accel, gyro = readings_from_true(truth[:, :3], truth[:, 3:], coefficients)
    if noise is not None:
        accel, gyro = accel + noise[:, :3], gyro + noise[:, 3:]
    return Increments(start_s, accel * interval_s, gyro * interval_s, np.full(count, interval_s))


def three(planted: Terms, **options: object) -> list[Increments]:
    return [rest(60.0 * k, planted, **options) for k in range(3)]  # type: ignore[arg-type]


def run(planted: Terms, C_tb: Array = LEVEL, **options: object) -> ChainResult:
    return paper_chain(three(planted, C_tb=C_tb, **options), aligned(C_tb), SITE, IDEAL, SILENT)


def test_line_through_the_origin_over_eleven_nodes() -> None:
    k = np.arange(11.0)
    nodes = np.column_stack([3 * k, -k, 2 * k, k**2, k**2, np.zeros(11)])
    # Σk·k²/Σk² = 3025/385.
    np.testing.assert_allclose(slopes_of_nodes(nodes, k), [3, -1, 2, 3025 / 385, 3025 / 385, 0], rtol=1e-14)


@pytest.mark.parametrize("axis", [0, 1])
def test_first_stage_puts_the_gyro_shift_into_the_level_accelerometer_and_the_second_takes_it_out(axis: int) -> None:
    # ε about axis 2 tips the frame by ε·t and gains g·ε·t²/2 along axis 1; the line through the origin over 11 nodes
    # is k·g·ε·T with k = ½·Σk³/Σk²/10 = 3025/7700 = 0.39286, negated into f. About axis 1 the sign is the other.
    reading_shift = 2.4 * DEG_H
    g = np.zeros(3)
    g[axis] = -reading_shift
    result = run(Terms(np.zeros(3), g))
    expected = 3025 / 7700 * SITE.gravity_mps2 * reading_shift * 60.0 * (1.0 if axis == 0 else -1.0)
    other = 1 - axis
    assert result.stages[0].terms.f_mps2[other] == pytest.approx(expected, rel=2e-3)
    assert abs(expected) > 0.27 * MG
    assert abs(result.stages[1].terms.f_mps2[other]) < 3e-3 * abs(expected)
    assert abs(result.stages[2].terms.f_mps2[other]) < 2e-5 * abs(expected)


@pytest.mark.parametrize("C_tb", [LEVEL, TILTED], ids=["level", "tilted"])
@pytest.mark.parametrize("duration_s", [60.0, 20.0])
def test_chain_finds_the_planted_shift(C_tb: Array, duration_s: float) -> None:
    planted = Terms(np.array([0.3, -0.3, 0.3]) * MG, np.array([2.4, -2.4, 2.4]) * DEG_H)
    windows = [rest(duration_s * k, planted, C_tb=C_tb, duration_s=duration_s) for k in range(3)]
    result = paper_chain(windows, aligned(C_tb), SITE, IDEAL, SILENT)
    np.testing.assert_allclose(result.terms.f_mps2, planted.f_mps2, atol=1e-5 * MG)
    np.testing.assert_allclose(result.terms.g_radps, planted.g_radps, atol=1e-6 * DEG_H)
    # One stage alone is already right for gyros and the vertical, to the Earth's turn within it.
    np.testing.assert_allclose(result.stages[0].terms.g_radps, planted.g_radps, atol=0.01 * DEG_H)


def test_sign_of_every_term_is_added_to_the_reading() -> None:
    # A gyro that reads 1 deg/h too much needs −1 deg/h; an accelerometer 1 mg too little needs +1 mg.
    result = run(Terms(np.array([0.0, 0.0, MG]), np.array([0.0, 0.0, -DEG_H])))
    assert result.terms.f_mps2[2] == pytest.approx(MG, rel=1e-4)
    assert result.terms.g_radps[2] == pytest.approx(-DEG_H, rel=1e-4)


def test_nodes_are_the_velocity_and_tilt_at_tenths_of_the_stage() -> None:
    stage = paper_stage(rest(7.0, Terms(np.array([0.0, 0.0, -MG]), np.zeros(3))), aligned(LEVEL), SITE, IDEAL)
    np.testing.assert_allclose(stage.node_s, 7.0 + 6.0 * np.arange(11), atol=1e-9)
    np.testing.assert_allclose(stage.nodes[:, 2], MG * 6.0 * np.arange(11), rtol=1e-5)
    assert not stage.nodes[0].any()


def test_sampling_that_does_not_divide_into_tenths_costs_nothing() -> None:
    planted = Terms(np.array([0.0, 0.0, 0.3 * MG]), np.array([1.0, -1.0, 1.0]) * DEG_H)
    result = run(planted, duration_s=59.9, interval_s=0.7)
    np.testing.assert_allclose(result.terms.g_radps, planted.g_radps, atol=1e-5 * DEG_H)
    np.testing.assert_allclose(result.terms.f_mps2, planted.f_mps2, atol=1e-4 * MG)


def test_planted_shift_moves_that_term_alone_and_navigation_not_at_all() -> None:
    """The paper's Table 3: y-gyro bias coefficient raised by 80 %, same recording, azimuth and level given."""
    rng = np.random.default_rng(11)
    bias = np.array([0.0, 2.425 * DEG_H, 0.0])  # so that the rise is 1.94 deg/h, the paper's −0.440 to +1.500
    lab = Coefficients(
        np.diag([1.001, 0.999, 1.0005]),
        np.diag([0.999, 1.001, 1.0]),
        np.array([1.0, -2.0, 3.0]) * MG,
        np.diag([1.0004, 0.9997, 1.0002]),
        np.diag([1.0001, 1.0, 0.9998]),
        bias,
        np.array([[0.0, 1e-7, 0.0], [1e-7, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    )
    raised = replace(lab, gyro_bias_radps=1.8 * bias)
    planted = Terms(np.array([0.1, -0.2, 0.05]) * MG, np.array([0.2, 0.44, -1.0]) * DEG_H)
    scale = np.repeat([20e-6 * 9.8, math.radians(0.01) / 60], 3) / math.sqrt(0.1)
    windows = [
        rest(60.0 * k, planted, C_tb=TILTED, coefficients=lab, noise=rng.normal(size=(600, 6)) * scale)
        for k in range(3)
    ]
    results = [paper_chain(windows, aligned(TILTED), SITE, c, SILENT) for c in (lab, raised)]
    moved = results[1].terms + -results[0].terms
    np.testing.assert_allclose(moved.g_radps / DEG_H, [0.0, -1.94, 0.0], atol=1e-3)
    np.testing.assert_allclose(moved.f_mps2 / MG, 0.0, atol=1e-3)
    drive = rest(
        180.0, planted, C_tb=TILTED, coefficients=lab, duration_s=300.0, noise=rng.normal(size=(3000, 6)) * scale
    )
    ends = []
    for c, result in zip((lab, raised), results, strict=True):
        dv, dtheta = drive.true(c, result.terms)
        motion = navigate(dv, dtheta, drive.interval_s, TILTED, SITE, AZIMUTH)
        ends.append((motion.position_m, motion.velocity_mps))
    assert np.abs(ends[1][0] - ends[0][0]).max() < 0.01
    assert np.abs(ends[1][1] - ends[0][1]).max() < 1e-3


def flicker_factor(count: int, interval_s: float, longest_s: float) -> Array:
    """Cholesky factor (n, n) of the means of B = 1 flicker over n intervals, by the Fourier integral of its spectrum.

    Two-sided 1/(2πf)·(2/π)·atan(2πf·longest): 1/f, levelled off at the lowest frequencies as relaxations of at most
    ``longest_s`` do; sinc² for the averaging.
    """
    fine = 8
    step = interval_s / fine
    total = 2 ** math.ceil(math.log2(8 * longest_s / step))
    frequency = np.fft.rfftfreq(total, step)
    density = np.full_like(frequency, 2 * longest_s / math.pi)
    density[1:] = np.arctan(2 * math.pi * frequency[1:] * longest_s) / (math.pi**2 * frequency[1:])
    autocovariance = np.fft.irfft(density * np.sinc(frequency * interval_s) ** 2, total)[: count * fine : fine] / step
    return np.linalg.cholesky(toeplitz(autocovariance))


FLICKERING = Noise(
    **{f"accel_{a}": ChannelNoise(white=20e-6 * 9.8, flicker=8e-6 * 9.8, quantisation=2e-5) for a in "xyz"},
    **{
        f"gyro_{a}": ChannelNoise(white=math.radians(0.01) / 60, flicker=0.05 * DEG_H, quantisation=2e-7) for a in "xyz"
    },
)


def noise_rates(rng: np.random.Generator, flicker: Array, interval_s: float, noise: Noise) -> Array:
    """White, flicker and quantisation noise of six channels (n, 6) as rates."""
    columns, count = [], len(flicker)
    for name in ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"):
        channel: ChannelNoise = getattr(noise, name)
        rate = rng.normal(size=count) * channel.white / math.sqrt(interval_s)
        rate += channel.flicker * (flicker @ rng.normal(size=count))
        rounding = rng.uniform(-0.5, 0.5, count + 1) * channel.quantisation
        columns.append(rate + np.diff(rounding) / interval_s)
    return np.column_stack(columns)


def test_covariance_is_the_scatter_of_the_terms() -> None:
    """NEES of noise part and of the whole, bias instability, quantisation, level and azimuth errors in."""
    runs, interval, level_sigma, azimuth_sigma = 300, 0.5, math.radians(0.003), math.radians(0.1)
    stated = aligned(TILTED, level_sigma, azimuth_sigma)
    sample = three(Terms.zero(), C_tb=TILTED, interval_s=interval)
    predicted = paper_chain(sample, stated, SITE, IDEAL, FLICKERING)
    flicker = flicker_factor(360, interval, 2e4)
    errors = np.empty((2, runs, 6))
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        planted = Terms(rng.normal(size=3) * 0.3 * MG, rng.normal(size=3) * 2.4 * DEG_H)
        rates = noise_rates(rng, flicker, interval, FLICKERING)
        wrong = rotation_matrix(rng.normal(size=3) * [level_sigma, level_sigma, azimuth_sigma]) @ TILTED
        for part, C_tb in enumerate((TILTED, wrong)):
            terms = None
            for k in range(3):
                window = rest(60.0 * k, planted, C_tb=TILTED, interval_s=interval, noise=rates[120 * k : 120 * k + 120])
                terms = paper_stage(window, aligned(C_tb), SITE, IDEAL, terms).terms
            assert terms is not None
            errors[part, seed] = np.concatenate([terms.f_mps2 - planted.f_mps2, terms.g_radps - planted.g_radps])
    low, high = chi2.ppf([0.0005, 0.9995], 6 * runs) / runs
    one_low, one_high = chi2.ppf([0.0005 / 6, 1 - 0.0005 / 6], runs) / runs
    for part, covariance in enumerate((predicted.noise_covariance, predicted.covariance)):
        nees = np.mean(np.einsum("ri,ij,rj->r", errors[part], np.linalg.inv(covariance), errors[part]))
        assert low < nees < high, (part, nees)
        each = np.mean(errors[part] ** 2, axis=0) / np.diag(covariance)
        assert np.all((one_low < each) & (each < one_high)), (part, each)


def test_level_accelerometer_terms_are_the_weak_ones() -> None:
    # White gyro noise N tilts the frame: the last stage leaves σ(g) = N·√(Σ weights²) and level f an order above f_z.
    white = Noise(**{f"gyro_{a}": ChannelNoise(white=math.radians(0.01) / 60) for a in "xyz"})
    result = paper_chain(three(Terms.zero()), aligned(LEVEL), SITE, IDEAL, white)
    sigma_f, sigma_g = np.sqrt(np.diag(result.noise_covariance))[:3], np.sqrt(np.diag(result.noise_covariance))[3:]
    # Angle nodes are a random walk of N²·6 s a step: weights Σ_{k≥m} k over 385 give Σ_m(Σ_{k≥m} k)²/385² = 0.1198.
    tails = [sum(range(m, 11)) for m in range(1, 11)]
    expected = math.radians(0.01) / 60 / math.sqrt(6.0) * math.sqrt(sum(t * t for t in tails)) / 385
    np.testing.assert_allclose(sigma_g, expected, rtol=5e-3)
    assert sigma_f[0] > 0.01 * MG > 100 * sigma_f[2]


def test_reference_errors_go_into_the_terms_they_look_like() -> None:
    level, azimuth = 1e-4, 2e-3
    result = paper_chain(three(Terms.zero()), aligned(LEVEL, level, azimuth), SITE, IDEAL, SILENT)
    sigma = np.sqrt(np.diag(result.reference_covariance))
    np.testing.assert_allclose(sigma[:2], level * SITE.gravity_mps2, rtol=1e-4)
    assert sigma[2] < 1e-4 * sigma[0]
    # Azimuth turns the level Earth rate: north into east and east into north; level mixes in the vertical rate.
    north, west, up = RATE
    np.testing.assert_allclose(
        sigma[3:],
        [
            math.hypot(azimuth * west, level * up),
            math.hypot(azimuth * north, level * up),
            level * math.hypot(north, west),
        ],
        rtol=1e-4,
    )
    assert not any(result.unseen)
    assert not result.unobservable


def test_block_that_levels_itself_has_no_sigma_for_its_level_accelerometers() -> None:
    windows = three(Terms(np.array([0.3, -0.3, 0.3]) * MG, np.zeros(3)))
    reference = Reference(AZIMUTH, 1e-3)
    alignment = coarse_alignment(
        rest(0.0, Terms(np.array([0.3, -0.3, 0.3]) * MG, np.zeros(3))), IDEAL, SITE, reference, SILENT
    )
    result = paper_chain(windows, alignment, SITE, IDEAL, SILENT)
    assert result.unseen == (True, True, False, False, False, False)
    assert result.sigma[:2] == [None, None]
    assert all(s is not None for s in result.sigma[2:])
    assert np.abs(result.terms.f_mps2[:2]).max() < 1e-3 * MG
    assert result.terms.f_mps2[2] == pytest.approx(0.3 * MG, rel=1e-3)
    texts = " / ".join(c.text for c in result.unobservable)
    assert "x accelerometer bias and pitch are one" in texts
    assert "y accelerometer bias and roll are one" in texts
    assert "1 mg ≡ 1 mrad" in texts
    assert np.all(np.isfinite(result.covariance))


def test_block_that_finds_its_own_azimuth_has_no_sigma_for_its_east_gyro() -> None:
    windows = three(Terms.zero())
    alignment = coarse_alignment(windows[0], IDEAL, SITE, Reference(None, 0.0, 0.0, 0.0), SILENT)
    result = paper_chain(windows, alignment, SITE, IDEAL, SILENT)
    assert result.unseen == (False, False, False, True, True, False)
    assert any("azimuth" in c.text and "gyro" in c.text for c in result.unobservable)


def test_unequal_scale_factors_rectify_noise_and_are_counted() -> None:
    # A level accelerometer about zero: (S⁺ − S⁻)·σ/√(2π) is added to its mean and lands in the term, negated.
    sigma, difference = 5e-3 * 9.8, 4e-3
    c = Coefficients(accel_positive=np.diag([1.0 + difference, 1.0, 1.0]))
    rng = np.random.default_rng(4)
    noise = np.zeros((6000, 6))
    windows = []
    for k in range(3):
        half = rng.normal(size=3000) * sigma
        noise[:, 0] = np.column_stack([half, -half]).ravel()  # leaves no velocity but what is rectified
        windows.append(rest(60.0 * k, Terms.zero(), interval_s=0.01, noise=noise))
    result = paper_chain(windows, aligned(LEVEL), SITE, c, SILENT)
    expected = difference * sigma / math.sqrt(2 * math.pi)
    assert math.sqrt(result.reference_covariance[0, 0]) == pytest.approx(expected, rel=0.05)
    assert result.terms.f_mps2[0] == pytest.approx(-expected, rel=0.05)
    equal = paper_chain(windows, aligned(LEVEL), SITE, IDEAL, SILENT)
    assert equal.reference_covariance[0, 0] < 1e-20


def test_repaired_samples_are_counted() -> None:
    windows = three(Terms.zero())
    windows[1] = replace(windows[1], repaired=3)
    assert paper_chain(windows, aligned(LEVEL), SITE, IDEAL, SILENT).repaired == 3


def test_what_cannot_be_run_is_refused() -> None:
    with pytest.raises(ValueError, match="no window"):
        paper_chain([], aligned(LEVEL), SITE, IDEAL, SILENT)
    with pytest.raises(ValueError, match="9 samples"):
        paper_stage(rest(0.0, Terms.zero(), duration_s=0.9), aligned(LEVEL), SITE, IDEAL)


def test_real_ring_laser_block(shared_data: Path) -> None:
    """Quiet vehicle, windows as a run takes them from the start (30 s to align, 3 × 60 s).

    The chain's terms are the last stage's, so that is where the mean rate is the Earth's to 0.15 deg/h; over all three
    stages the vehicle's slow tilt, 10 arcsec a minute, is between the stages' own means.
    """
    table = pq.read_table(shared_data / "recordings" / "rlg_vehicle_quiet.parquet")
    dv = np.column_stack([table[f"dv_{a}_mps"].to_numpy() for a in "xyz"])
    dtheta = np.column_stack([table[f"dtheta_{a}_rad"].to_numpy() for a in "xyz"])
    interval = np.full(len(dv), 0.01)
    site, azimuth = Site.at(math.radians(34.246048), 380.0), math.radians(90.6)

    def window(start: int, end: int) -> Increments:
        part = slice(start * 100, end * 100)
        return increments_of(
            np.arange(end * 100 - start * 100), table["time_s"].to_numpy()[part], dv[part], dtheta[part], interval[part]
        )

    noise = noise_of_block(dv[:21000] / 0.01, dtheta[:21000] / 0.01, 0.01)
    alignment = coarse_alignment(window(0, 30), IDEAL, site, Reference(azimuth, math.radians(0.5)), noise)
    result = paper_chain([window(30, 90), window(90, 150), window(150, 210)], alignment, site, IDEAL, noise)
    earth_rate = alignment.C_tb.T @ site.earth_rate_radps(azimuth)
    for start, tolerance in ((150, 0.15), (30, 0.3)):
        mean = dtheta[start * 100 : 21000].sum(axis=0) / (210 - start) + result.terms.g_radps
        np.testing.assert_allclose(mean / DEG_H, earth_rate / DEG_H, atol=tolerance)
    assert abs(result.terms.f_mps2[2]) < 0.02 * MG
    assert result.sigma[0] is None
    sigma_g = np.sqrt(np.diag(result.covariance))[3:]
    assert np.all(np.abs(result.terms.g_radps) < 3 * sigma_g), "this block is good: no significant shift"
