"""The optimal estimator: exact without noise, at the Bayesian bound with it, honest about what it is told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from inertial.attitude import body_to_tangent, rotation_matrix
from inertial.documents import ChannelNoise, Noise
from inertial.earth import Site
from inertial.error_model import Coefficients, Terms, readings_from_true
from inertial.increment_covariance import integral_covariance
from inertial.optimal import (
    LauncherReference,
    Nodes,
    Priors,
    Segment,
    Turn,
    estimate,
    estimate_nodes,
    estimate_stages,
    node_weights,
)

DEG = math.pi / 180.0
DEG_PER_H = DEG / 3600.0
MG = 9.80665e-3
SITE = Site.at(35.7 * DEG, 1200.0)
AZIMUTH = 40.0 * DEG
PLANTED = Terms(np.array([0.3, -0.3, 0.3]) * MG, np.array([2.4, -2.4, 2.4]) * DEG_PER_H)
VRW, ARW, FLICKER = 20e-6 * 9.80665, 0.01 * DEG / 60.0, 0.02 * DEG_PER_H
ACCEL, GYRO = ChannelNoise(white=VRW), ChannelNoise(white=ARW, flicker=FLICKER)


def block_noise(accel: ChannelNoise = ACCEL, gyro: ChannelNoise = GYRO) -> Noise:
    return Noise(accel_x=accel, accel_y=accel, accel_z=accel, gyro_x=gyro, gyro_y=gyro, gyro_z=gyro)


def still(
    C_tb: np.ndarray,
    *,
    azimuth: float = AZIMUTH,
    seconds: float = 60.0,
    start_s: float = 0.0,
    rate_hz: float = 10.0,
    coefficients: Coefficients | None = None,
    turns: tuple[Turn, ...] = (),
    rng: np.random.Generator | None = None,
) -> Segment:
    """Return readings of a block at rest with the planted shift, with white noise if ``rng`` is given."""
    count, dt = int(seconds * rate_hz), 1.0 / rate_hz
    accel = np.tile(C_tb.T @ [0.0, 0.0, SITE.gravity_mps2], (count, 1))
    gyro = np.tile(C_tb.T @ SITE.earth_rate_radps(azimuth), (count, 1))
    accel, gyro = readings_from_true(accel, gyro, coefficients or Coefficients.ideal(), PLANTED)
    if rng is not None:
        accel += rng.standard_normal((count, 3)) * VRW / math.sqrt(dt)
        gyro += rng.standard_normal((count, 3)) * ARW / math.sqrt(dt)
    return Segment(start_s + dt * np.arange(1, count + 1), accel * dt, gyro * dt, np.full(count, dt), turns)


@pytest.mark.parametrize("level_frame", ["tangent", "body"])
def test_large_reference_errors_are_found_exactly_from_attitudes_enough(level_frame: str) -> None:
    """Tilts of milliradians, an azimuth wrong by degrees and turns wrong by a tenth of one: nothing is linear here."""
    believed = body_to_tangent(0.02, 0.3, 0.5)
    azimuth = AZIMUTH + 3.0 * DEG
    tilt = np.array([1e-3, -2e-3, 0.0])
    stated = [
        Turn(np.array([0.0, 0.0, 1.0]), 2.0, "tangent", 0.1 * DEG),
        Turn(np.array([0.0, 1.0, 0.0]), -0.9, "body", 0.1 * DEG),
        Turn(np.array([1.0, 0.2, 0.0]), 1.2, "body", 0.1 * DEG),
    ]
    errors = (0.1 * DEG, -0.05 * DEG, 0.08 * DEG)
    segments, C = [], believed
    for k in range(4):
        if k:
            turn = stated[k - 1]
            turned = rotation_matrix(turn.axis / np.linalg.norm(turn.axis) * (turn.angle_rad + errors[k - 1]))
            C = turned @ C if turn.frame == "tangent" else C @ turned
        true = rotation_matrix(tilt) @ C if level_frame == "tangent" else C @ rotation_matrix(believed.T @ tilt)
        turns = (stated[k - 1],) if k else ()
        segments.append(still(true, azimuth=azimuth, start_s=100.0 * k, turns=turns))
    # No prior pulls: whatever the data can tell, they tell alone.
    free = [
        Segment(
            s.time_s,
            s.dv_mps,
            s.dtheta_rad,
            s.interval_s,
            tuple(Turn(t.axis, t.angle_rad, t.frame, math.inf) for t in s.turns),
        )
        for s in segments
    ]
    reference = LauncherReference(believed, AZIMUTH, math.inf, math.inf, level_frame)  # type: ignore[arg-type]
    found = estimate(free, SITE, reference, block_noise(), Coefficients.ideal())
    assert np.all(np.isfinite(found.sigma))
    np.testing.assert_allclose(found.terms.f_mps2, PLANTED.f_mps2, atol=1e-9)
    np.testing.assert_allclose(found.terms.g_radps, PLANTED.g_radps, atol=1e-13)
    np.testing.assert_allclose(found.value[6:9], [*tilt[:2], 3.0 * DEG], atol=1e-8)
    np.testing.assert_allclose(found.value[9:], errors, atol=1e-8)
    np.testing.assert_allclose(found.C_tb[-1], true, atol=1e-8)


def test_white_noise_sigma_is_that_of_the_mean() -> None:
    found = estimate(
        [still(np.eye(3), start_s=60.0 * k) for k in range(3)],
        SITE,
        LauncherReference(np.eye(3), AZIMUTH, 0.0, 0.0),
        block_noise(gyro=ChannelNoise(white=ARW)),
        Coefficients.ideal(),
    )
    expected = [VRW / math.sqrt(180.0)] * 3 + [ARW / math.sqrt(180.0)] * 3
    np.testing.assert_allclose(found.sigma[:6], expected, rtol=1e-4)


def test_covariance_is_the_bayesian_bound_worked_out_by_hand() -> None:
    """An upright block: J = HᵀR⁻¹H + P₀⁻¹ with H by differences of rotated vectors and R of the whole record."""
    priors = Priors(np.full(3, 0.3 * MG), np.full(3, 2.4 * DEG_PER_H))
    level, azimuth = 0.003 * DEG, 0.1 * DEG
    found = estimate(
        [still(np.eye(3), start_s=60.0 * k) for k in range(3)],
        SITE,
        LauncherReference(np.eye(3), AZIMUTH, level, azimuth),
        block_noise(),
        Coefficients.ideal(),
        priors,
    )

    def rest(x: np.ndarray) -> np.ndarray:
        back = rotation_matrix(-np.array([x[6], x[7], 0.0]))
        earth = SITE.earth_rate_radps(AZIMUTH + x[8])
        return np.concatenate([back @ [0.0, 0.0, SITE.gravity_mps2], back @ earth]) - x[:6]

    # The record's mean is within 0.01 % of the best weights for this noise, so 1/Var(mean) is its information.
    spans = np.array([[0.0, 180.0]])
    information = [180.0**2 / integral_covariance(channel, spans)[0, 0] for channel in [ACCEL] * 3 + [GYRO] * 3]
    H = np.column_stack([(rest(h) - rest(-h)) / 2e-6 for h in np.eye(9) * 1e-6])
    sigma0 = np.concatenate([priors.f_sigma_mps2, priors.g_sigma_radps, [level, level, azimuth]])
    bound = np.linalg.inv(H.T @ (np.array(information)[:, None] * H) + np.diag(sigma0**-2.0))
    np.testing.assert_allclose(found.sigma, np.sqrt(np.diag(bound)), rtol=1e-3)
    size = np.sqrt(np.diag(bound))
    np.testing.assert_allclose(found.covariance / np.outer(size, size), bound / np.outer(size, size), atol=2e-3)
    np.testing.assert_allclose(sum(found.sources.values()), found.covariance, rtol=1e-9)


def test_spread_and_normalised_error_over_runs_with_drawn_truth() -> None:
    """400 runs, noise drawn on the nodes from its own covariance; every band holds with 99.9 % by χ²."""
    rng = np.random.default_rng(5)
    runs, noise = 400, block_noise()
    priors = Priors(np.full(3, 0.3 * MG), np.full(3, 2.4 * DEG_PER_H))
    level, azimuth = 0.003 * DEG, 0.1 * DEG
    sigma0 = np.concatenate([priors.f_sigma_mps2, priors.g_sigma_radps, [level, level, azimuth]])
    reference = LauncherReference(np.eye(3), AZIMUTH, level, azimuth)
    spans = np.column_stack([np.arange(180.0), np.arange(180.0) + 1.0])
    roots = [np.linalg.cholesky(integral_covariance(channel, spans)) for channel in [ACCEL] * 3 + [GYRO] * 3]
    weights, errors, nees = None, [], []
    for _ in range(runs):
        truth = rng.standard_normal(9) * sigma0
        C = rotation_matrix(np.array([truth[6], truth[7], 0.0]))
        rest = np.concatenate([C.T @ [0.0, 0.0, SITE.gravity_mps2], C.T @ SITE.earth_rate_radps(AZIMUTH + truth[8])])
        integral = np.column_stack([root @ rng.standard_normal(180) for root in roots]) + rest - truth[:6]
        nodes = [Nodes(spans, np.ones(180), integral, rest, np.ones(6), ())]
        weights = weights or node_weights(nodes, noise)
        found = estimate_nodes(nodes, weights, SITE, reference, noise, Coefficients.ideal(), priors)
        errors.append(found.value - truth)
        nees.append(errors[-1] @ np.linalg.solve(found.covariance, errors[-1]))
    ratio = np.mean((np.array(errors) / found.sigma) ** 2, axis=0)
    share = 0.001 / 18  # nine components, two sides
    assert np.all(ratio < chi2.ppf(1.0 - share, runs) / runs)
    assert np.all(ratio > chi2.ppf(share, runs) / runs)
    low, high = chi2.ppf([0.0005, 0.9995], 9 * runs) / runs
    assert low < np.mean(nees) < high


def test_stages_pool_what_came_before() -> None:
    rng = np.random.default_rng(1)
    segments = [still(np.eye(3), start_s=60.0 * k, rng=rng) for k in range(3)]
    reference = LauncherReference(np.eye(3), AZIMUTH, 0.0, 0.0)
    noise = block_noise(gyro=ChannelNoise(white=ARW))
    stages = estimate_stages(segments, SITE, reference, noise, Coefficients.ideal())
    whole = estimate(segments, SITE, reference, noise, Coefficients.ideal())
    np.testing.assert_array_equal(stages[-1].value, whole.value)
    for k, stage in enumerate(stages, 1):
        np.testing.assert_allclose(stage.sigma[:6], whole.sigma[:6] * math.sqrt(3.0 / k), rtol=1e-4)
        assert np.all(np.abs(stage.terms.g_radps - PLANTED.g_radps) < 5.0 * stage.sigma[3:6])
    assert np.all(np.abs(whole.fit - 1.0) < 5.0 * math.sqrt(2.0 / whole.fit_degrees))


def test_readings_at_rest_err_by_the_mean_noise_whatever_the_reference() -> None:
    reference = LauncherReference(body_to_tangent(0.1, 0.2, 0.3), AZIMUTH, 1e-3, 1e-2)
    segment = still(reference.C_tb, seconds=100.0)
    found = estimate([segment], SITE, reference, block_noise(gyro=ChannelNoise(white=ARW)), Coefficients.ideal())
    expected = np.repeat(-np.eye(6)[:, None, :] / 100.0, 100, axis=1)
    np.testing.assert_allclose(found.rest_weights, expected, atol=1e-8)


def test_lost_samples_and_pauses_cost_only_their_time() -> None:
    whole = still(np.eye(3), seconds=180.0)
    kept = np.random.default_rng(2).random(1800) > 0.3
    kept[700:900] = False
    part = Segment(whole.time_s[kept], whole.dv_mps[kept], whole.dtheta_rad[kept], whole.interval_s[kept])
    reference = LauncherReference(np.eye(3), AZIMUTH, 0.0, 0.0)
    found = estimate([part], SITE, reference, block_noise(), Coefficients.ideal())
    np.testing.assert_allclose(found.terms.f_mps2, PLANTED.f_mps2, atol=1e-10)
    np.testing.assert_allclose(found.terms.g_radps, PLANTED.g_radps, atol=1e-15)
    assert found.sigma[2] == pytest.approx(VRW / math.sqrt(0.1 * kept.sum()), rel=1e-3)


def test_random_walk_term_is_the_shift_at_the_end() -> None:
    """A walk that dwarfs the white noise: the estimate follows its end and its σ is the filter's steady state."""
    walk, white = 1e-6, 1e-5
    gyro = ChannelNoise(white=white, random_walk=walk)
    found = estimate(
        [still(np.eye(3), seconds=180.0)],
        SITE,
        LauncherReference(np.eye(3), AZIMUTH, 0.0, 0.0),
        block_noise(gyro=gyro),
        Coefficients.ideal(),
    )
    # Continuous Kalman filter of a walk in white noise: P = walk·white (Gelb, Applied Optimal Estimation, 4.6).
    assert found.sigma[3] == pytest.approx(math.sqrt(walk * white), rel=0.01)
    assert np.all(found.gain[3, 3, -10:] < found.gain[3, 3, :10].min())


def test_what_nothing_bounds_leaves_the_reference_as_given() -> None:
    tilted = rotation_matrix(np.array([1e-3, 0.0, 0.0]))
    reference = LauncherReference(np.eye(3), AZIMUTH, math.inf, math.inf)
    found = estimate([still(tilted)], SITE, reference, block_noise(), Coefficients.ideal())
    np.testing.assert_allclose(found.value[6:], 0.0, atol=1e-12)
    upright = np.array([0.0, 0.0, SITE.gravity_mps2])
    seen = found.terms.f_mps2 + tilted.T @ upright
    np.testing.assert_allclose(seen, upright + PLANTED.f_mps2, atol=1e-9)
    assert np.all(found.unseen[:2])


def test_a_belief_is_told_from_knowledge() -> None:
    reference = LauncherReference(np.eye(3), AZIMUTH, math.inf, 0.1 * DEG)
    priors = Priors(f_sigma_mps2=np.full(3, MG))
    found = estimate([still(np.eye(3))], SITE, reference, block_noise(), Coefficients.ideal(), priors)
    np.testing.assert_allclose(found.sigma[:2], MG, rtol=1e-3)
    np.testing.assert_array_equal(found.unseen[:6], [True, True, False, False, False, False])


def test_rectified_noise_is_in_the_term_and_counted() -> None:
    """S⁺ ≠ S⁻ on a level channel: the reading's mean moves by (S⁺ − S⁻)·σ/√(2π)."""
    asymmetry = 0.1
    split = Coefficients(accel_positive=np.diag([1.0 + asymmetry, 1.0, 1.0]))
    segment = still(np.eye(3), seconds=180.0, rate_hz=100.0, coefficients=split, rng=np.random.default_rng(3))
    level = Segment(
        segment.time_s,
        segment.dv_mps + np.array([PLANTED.f_mps2[0] * 0.01, 0.0, 0.0]),  # its mean reading at zero
        segment.dtheta_rad,
        segment.interval_s,
    )
    reference = LauncherReference(np.eye(3), AZIMUTH, 0.0, 0.0)
    found = estimate([level], SITE, reference, block_noise(), split)
    expected = asymmetry * VRW * 10.0 / math.sqrt(2.0 * math.pi)
    assert math.sqrt(found.sources["rectification"][0, 0]) == pytest.approx(expected, rel=0.05)
    noise_only = math.sqrt(found.sources["noise of accel_x"][0, 0])
    assert abs(found.terms.f_mps2[0] + expected) < 4.0 * noise_only
    assert expected > 4.0 * noise_only
    assert found.sigma[0] == pytest.approx(math.hypot(expected, noise_only), rel=0.05)


def test_a_walk_fitted_by_chance_is_left_out_and_a_real_one_kept() -> None:
    rng = np.random.default_rng(8)
    segments = [still(np.eye(3), start_s=60.0 * k, rng=rng) for k in range(3)]
    walk = ARW / 5.0  # takes over from the white noise after five seconds
    suspected = block_noise(gyro=ChannelNoise(white=ARW, random_walk=walk)).model_copy(update={"free": True})
    reference = LauncherReference(np.eye(3), AZIMUTH, 0.0, 0.0)
    quiet = estimate(segments, SITE, reference, suspected, Coefficients.ideal())
    assert quiet.noise.gyro_x.random_walk == 0.0
    assert quiet.sigma[3] == pytest.approx(ARW / math.sqrt(180.0), rel=1e-3)
    drift = np.cumsum(rng.standard_normal((1800, 3)), axis=0) * walk * math.sqrt(0.1) * 0.1
    walking = [
        Segment(s.time_s, s.dv_mps, s.dtheta_rad + drift[600 * k : 600 * k + 600], s.interval_s)
        for k, s in enumerate(segments)
    ]
    assert estimate(walking, SITE, reference, suspected, Coefficients.ideal()).noise.gyro_x.random_walk == walk


def test_no_samples_is_refused() -> None:
    reference = LauncherReference(np.eye(3), AZIMUTH, 0.0, 0.0)
    with pytest.raises(ValueError, match="still spans with samples"):
        estimate([], SITE, reference, block_noise(), Coefficients.ideal())
