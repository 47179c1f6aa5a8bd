"""The error budget: closed forms where they exist, Monte Carlo of full strapdown navigation where they do not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom, chi

from inertial.attitude import rotation_matrix
from inertial.budget import Errors, Profile, predict, radial_probability, radial_quantile
from inertial.documents import ChannelNoise, Noise, Uncertainty
from inertial.earth import Site
from inertial.error_model import Coefficients, Terms
from inertial.increment_covariance import integral_covariance
from inertial.optimal import (
    LauncherReference,
    OptimalEstimate,
    Segment,
    Turn,
    estimate,
    estimate_nodes,
    node_weights,
    nodes_of,
)
from inertial.rest_response import AtRest
from inertial.strapdown import navigate

DEG = math.pi / 180.0
SITE = Site.at(35.7 * DEG, 1200.0)
AZIMUTH = 40.0 * DEG
VRW, ARW, FLICKER = 20e-6 * 9.80665, 0.01 * DEG / 60.0, 0.05 * DEG / 3600.0
UPRIGHT = np.array([0.0, 0.0, SITE.gravity_mps2])
ORDER = ("f_x", "f_y", "f_z", "g_x", "g_y", "g_z", "level_1", "level_2", "azimuth")
QUIET = Noise()


def block_noise(accel: ChannelNoise, gyro: ChannelNoise) -> Noise:
    return Noise(accel_x=accel, accel_y=accel, accel_z=accel, gyro_x=gyro, gyro_y=gyro, gyro_z=gyro)


def only(name: str, sigma: float) -> Errors:
    covariance = np.zeros((9, 9))
    k = ORDER.index(name)
    covariance[k, k] = sigma**2
    return Errors.of_covariance(ORDER, covariance)


# ---- closed forms -------------------------------------------------------------------------------------------------


def test_accelerometer_term_grows_with_half_the_square_of_time() -> None:
    budget = predict(only("f_x", 1e-3), Profile.rest(np.eye(3), 100.0, SITE), SITE, AZIMUTH, QUIET, [10.0, 100.0])
    np.testing.assert_allclose(budget.sigma[:, 0], 0.5e-3 * np.array([10.0, 100.0]) ** 2, rtol=3e-3)


def test_gyro_term_grows_with_the_cube() -> None:
    profile = Profile.rest(np.eye(3), 100.0, SITE)
    budget = predict(only("g_y", 1e-6), profile, SITE, AZIMUTH, QUIET, 100.0, gravity_gradient=False)
    assert budget.sigma[0, 0] == pytest.approx(SITE.gravity_mps2 * 1e-6 * 100.0**3 / 6.0, rel=3e-3)


def test_white_noise_alone_is_an_integrated_walk() -> None:
    noise = block_noise(ChannelNoise(white=1e-3), ChannelNoise())
    profile = Profile.rest(np.eye(3), 100.0, SITE)
    budget = predict(only("f_x", 0.0), profile, SITE, AZIMUTH, noise, 100.0, gravity_gradient=False)
    assert budget.sigma[0, 0] == pytest.approx(1e-3 * math.sqrt(100.0**3 / 3.0), rel=3e-3)
    assert budget.sigma[0, 3] == pytest.approx(1e-3 * math.sqrt(100.0), rel=3e-3)


def test_shares_of_independent_causes_add_up() -> None:
    noise = block_noise(ChannelNoise(white=VRW), ChannelNoise(white=ARW))
    budget = predict(only("g_x", 1e-7), Profile.rest(np.eye(3), 60.0, SITE), SITE, AZIMUTH, noise, [30.0, 60.0])
    for row in budget.contributors(most=20):
        assert sum(share for _, share in row) == pytest.approx(1.0, abs=0.01)
        assert [share for _, share in row] == sorted((share for _, share in row), reverse=True)
    document = budget.summary()
    assert document["radial_m"]["50"][0] < document["radial_m"]["95"][0]


def test_a_time_beyond_the_profile_is_refused() -> None:
    with pytest.raises(ValueError, match="profile runs from 0 to 60"):
        predict(only("g_x", 1e-7), Profile.rest(np.eye(3), 60.0, SITE), SITE, AZIMUTH, QUIET, 61.0)


# ---- the size of a correlated vector ------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_radius_of_an_isotropic_vector_is_chi_distributed(size: int, probability: float) -> None:
    assert radial_quantile(4.0 * np.eye(size), probability) == pytest.approx(2.0 * chi.ppf(probability, size), rel=1e-8)


@pytest.mark.parametrize("sigma", [(1.0, 1.0, 1e-4), (1.0, 0.3, 0.05), (1.0, 0.01, 0.01), (1.0, 0.9, 0.0)])
def test_radius_of_an_elongated_vector_by_counting(sigma: tuple[float, float, float]) -> None:
    draws = np.random.default_rng(4).standard_normal((200_000, 3)) * sigma
    rotation = rotation_matrix(np.array([0.4, -1.0, 2.0]))
    covariance = rotation @ np.diag(np.square(sigma)) @ rotation.T
    for probability in (0.5, 0.95):
        inside = np.sum(np.linalg.norm(draws, axis=1) <= radial_quantile(covariance, probability))
        assert binom.ppf(0.0005, 200_000, probability) <= inside <= binom.ppf(0.9995, 200_000, probability)


def test_radial_probability_at_extreme_ratio_is_that_of_one_axis() -> None:
    assert radial_probability([1.0, 1e-7, 1e-7], 1.0) == pytest.approx(math.erf(math.sqrt(0.5)), abs=1e-9)


# ---- what the run could not tell apart ----------------------------------------------------------------------------


def still(C_tb: np.ndarray, start_s: float = 0.0, turns: tuple[Turn, ...] = ()) -> Segment:
    ones = np.ones((120, 1))
    earth = SITE.earth_rate_radps(AZIMUTH)
    return Segment(
        start_s + np.arange(1.0, 121.0), ones * (C_tb.T @ UPRIGHT), ones * (C_tb.T @ earth), ones[:, 0], turns
    )


def self_levelled() -> OptimalEstimate:
    reference = LauncherReference(np.eye(3), AZIMUTH, math.inf, 1e-3)
    noise = block_noise(ChannelNoise(white=VRW), ChannelNoise(white=ARW))
    return estimate([still(np.eye(3))], SITE, reference, noise, Coefficients.ideal())


def half_turn(seconds: float) -> Profile:
    time = np.arange(0.0, seconds + 0.5)
    angle = np.minimum(time * math.pi / 60.0, math.pi)
    C_tb = rotation_matrix(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    return Profile.on_the_spot(time, C_tb, SITE)


def test_bias_and_tilt_cancel_at_rest_but_not_after_a_turn() -> None:
    found = self_levelled()
    errors = Errors.of_estimate(found)
    rest = predict(errors, Profile.rest(np.eye(3), 120.0, SITE), SITE, AZIMUTH, found.noise, 120.0)
    turned = predict(errors, half_turn(120.0), SITE, AZIMUTH, found.noise, 120.0)
    assert np.all(np.isfinite(rest.sigma[0, :6]))
    assert np.all(np.isinf(rest.sigma[0, 6:8]))  # its tilt is not known even so
    assert np.isinf(turned.radial_m(0.5)[0])
    assert turned.summary()["radial_m"]["95"] == [None]


def test_the_same_from_the_numbers_of_a_result() -> None:
    found = self_levelled()
    unbounded = [unseen.weights for unseen in found.unobservable if unseen.bounded_by == "nothing"]
    errors = Errors.of_covariance(found.order, found.covariance, unbounded)
    rest = predict(errors, Profile.rest(np.eye(3), 120.0, SITE), SITE, AZIMUTH, found.noise, 120.0)
    exact = predict(Errors.of_estimate(found), Profile.rest(np.eye(3), 120.0, SITE), SITE, AZIMUTH, found.noise, 120.0)
    np.testing.assert_allclose(rest.radial_m(0.5), exact.radial_m(0.5), rtol=1e-6)  # white noise: no common past
    turned = predict(errors, half_turn(120.0), SITE, AZIMUTH, found.noise, 120.0)
    assert np.isinf(turned.radial_m(0.5)[0])


def test_a_believed_bias_shows_after_a_turn_at_its_size() -> None:
    """1 mg ≡ 1 mrad of tilt, turned by 180°: the two add up to 2·γ·tilt."""
    noise = block_noise(ChannelNoise(white=1e-7), ChannelNoise(white=1e-10))
    tilt = 1e-3
    found = AtRest(Terms.zero(), np.eye(3), AZIMUTH, np.zeros((6, 1, 6)), np.array([[-1.0, 0.0]]), np.zeros((6, 6)))
    chain = Errors.of_chain(found, SITE, tilt, 0.0)
    rest = predict(chain, Profile.rest(np.eye(3), 160.0, SITE), SITE, AZIMUTH, noise, 160.0)
    assert rest.radial_m(0.95)[0] < 1e-3
    flipped = Profile.on_the_spot([0.0, 0.001, 100.0], np.array([np.eye(3)] + [np.diag([-1.0, -1.0, 1.0])] * 2), SITE)
    turned = predict(chain, flipped, SITE, AZIMUTH, noise, 100.0, gravity_gradient=False)
    expected = 2.0 * SITE.gravity_mps2 * tilt * 100.0**2 / 2.0
    assert turned.sigma[0, 0] == pytest.approx(expected, rel=0.02)
    assert dict(turned.contributors()[0])["level reference"] > 0.99


def test_a_document_keeps_the_budget_to_two_per_cent() -> None:
    """Past noise in spans of 5 s instead of the nodes' 1 s, flicker, walk and quantisation in it."""
    noise = block_noise(
        ChannelNoise(white=VRW, flicker=FLICKER), ChannelNoise(white=ARW, flicker=FLICKER * 1e-3, random_walk=1e-8)
    )
    reference = LauncherReference(np.eye(3), AZIMUTH, 1e-4, 1e-3)
    found = estimate([still(np.eye(3))], SITE, reference, noise, Coefficients.ideal())
    errors = Errors.of_estimate(found)
    document = errors.to_document(found.C_tb[-1], found.azimuth_rad)
    assert Uncertainty.model_validate_json(document.canonical_json()) == document
    profile = Profile.rest(np.eye(3), 300.0, SITE)
    exact, kept = (
        predict(one, profile, SITE, AZIMUTH, noise, [60.0, 300.0], after_s=60.0)
        for one in (errors, Errors.of_document(document))
    )
    np.testing.assert_allclose(kept.sigma, exact.sigma, rtol=0.02)


def test_slow_flicker_in_the_term_helps_the_flight_that_follows_at_once() -> None:
    noise = block_noise(ChannelNoise(white=1e-6), ChannelNoise(white=1e-9, flicker=FLICKER))
    reference = LauncherReference(np.eye(3), AZIMUTH, 0.0, 0.0)
    found = estimate([still(np.eye(3))], SITE, reference, noise, Coefficients.ideal())
    profile, errors = Profile.rest(np.eye(3), 100.0, SITE), Errors.of_estimate(found)
    at_once, later, apart = (
        predict(errors, profile, SITE, AZIMUTH, noise, 100.0, after_s=after_s).radial_m(0.5)[0]
        for after_s in (0.0, 3600.0, None)
    )
    assert at_once < 0.6 * later
    assert later < apart


# ---- Monte Carlo of strapdown navigation --------------------------------------------------------------------------

RATE_HZ, REST_S, FLIGHT_S, RUNS = 5.0, 180, 200, 200
LEVEL, AZIMUTH_SIGMA = 0.02 * DEG, 0.1 * DEG


def motion(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return attitude (n+1, 3, 3) relative to the start and case acceleration increments (n, 3) along body x."""
    count = int(FLIGHT_S * RATE_HZ)
    time = np.arange(count + 1) / RATE_HZ
    angle = np.clip(time - 20.0, 0.0, 90.0) * DEG if kind == "turning" else np.zeros(count + 1)
    turned = rotation_matrix(angle[:, None] * np.array([0.2, 0.0, 1.0]) / math.hypot(0.2, 1.0))
    speed = np.zeros(count + 1)
    if kind == "vibration":
        speed[50:-50] = np.random.default_rng(9).standard_normal(count - 99) * 0.5  # about 0.3 g at this rate
    return turned, np.column_stack([np.diff(speed), np.zeros((count, 2))])


@pytest.mark.parametrize("kind", ["rest", "turning", "vibration"])
def test_navigation_lands_inside_the_predicted_bands(kind: str) -> None:
    """Truth drawn, flicker common to estimate and flight; counts within the 99.9 % binomial band at every check."""
    rng = np.random.default_rng(["rest", "turning", "vibration"].index(kind))
    accel, gyro = ChannelNoise(white=VRW), ChannelNoise(white=ARW, flicker=FLICKER)
    noise = block_noise(accel, gyro)
    reference = LauncherReference(np.eye(3), AZIMUTH, LEVEL, AZIMUTH_SIGMA)
    dt, total = 1.0 / RATE_HZ, REST_S + FLIGHT_S
    turned, shaken = motion(kind)
    # Flicker on 2 s spans over the whole time, spread evenly over the samples of each.
    width = 2.0
    spans = np.column_stack([np.arange(0.0, total, width), np.arange(0.0, total, width) + width])
    root = np.linalg.cholesky(integral_covariance(ChannelNoise(flicker=FLICKER, white=1e-12), spans))
    repeat = int(width * RATE_HZ)
    rest_count, count = int(REST_S * RATE_HZ), int(total * RATE_HZ)
    asked = np.array([100.0, 200.0])
    rows = (asked * RATE_HZ).astype(int)
    weights, budget, sizes = None, None, []
    for _ in range(RUNS):
        tilt = rng.standard_normal(3) * [LEVEL, LEVEL, 0.0]
        azimuth = AZIMUTH + rng.standard_normal() * AZIMUTH_SIGMA
        C_tb0, earth = rotation_matrix(tilt), SITE.earth_rate_radps(azimuth)
        C_tb = C_tb0 @ turned
        dv, dtheta = np.empty((count, 3)), np.empty((count, 3))
        dv[:rest_count], dtheta[:rest_count] = C_tb0.T @ UPRIGHT * dt, C_tb0.T @ earth * dt
        middle = 0.5 * (C_tb[1:] + C_tb[:-1])
        step = np.linalg.inv(turned[:-1]) @ turned[1:]
        turning = 0.5 * np.stack(
            [step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]], 1
        )
        dv[rest_count:] = np.einsum("kji,j->ki", middle, UPRIGHT) * dt + shaken
        dtheta[rest_count:] = np.einsum("kji,j->ki", middle, earth) * dt + turning
        true = navigate(dv[rest_count:], dtheta[rest_count:], dt, C_tb0, SITE, azimuth)
        shift = rng.standard_normal(6) * ([3e-3] * 3 + [1.2e-5] * 3)
        dv += rng.standard_normal((count, 3)) * VRW * math.sqrt(dt) + shift[:3] * dt
        dtheta += rng.standard_normal((count, 3)) * ARW * math.sqrt(dt) + shift[3:] * dt
        dtheta += np.repeat(root @ rng.standard_normal((len(spans), 3)), repeat, axis=0) / repeat
        time = dt * np.arange(1, rest_count + 1)
        segment = Segment(time, dv[:rest_count], dtheta[:rest_count], np.full(rest_count, dt))
        nodes = nodes_of([segment], Coefficients.ideal())
        weights = weights or node_weights(nodes, noise)
        found = estimate_nodes(nodes, weights, SITE, reference, noise, Coefficients.ideal())
        if budget is None:
            profile = Profile.of(true, SITE, AZIMUTH)
            budget = predict(Errors.of_estimate(found), profile, SITE, AZIMUTH, noise, asked)
        flight_dv = dv[rest_count:] + found.terms.f_mps2 * dt
        flight_dtheta = dtheta[rest_count:] + found.terms.g_radps * dt
        used = navigate(flight_dv, flight_dtheta, dt, found.C_tb[-1], SITE, found.azimuth_rad)
        position = (used.position_m - true.position_m)[rows]
        velocity = (used.velocity_mps - true.velocity_mps)[rows]
        sizes.append(
            [
                np.linalg.norm(position, axis=1),
                np.linalg.norm(position[:, :2], axis=1),
                np.linalg.norm(velocity, axis=1),
            ]
        )
    assert budget is not None
    size = np.array(sizes)
    for probability in (0.5, 0.95):
        low, high = binom.ppf([0.0005, 0.9995], RUNS, probability)
        for k, band in enumerate((budget.radial_m, budget.horizontal_m, budget.speed_mps)):
            inside = np.sum(size[:, k] <= band(probability), axis=0)
            assert np.all((inside >= low) & (inside <= high)), (kind, probability, k, inside, (low, high))
