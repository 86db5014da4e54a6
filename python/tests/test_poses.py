"""Geometry against its definitions."""

import numpy as np
import pytest

from driftless import Pose, Track, Unreadable
from driftless.plots import ellipse
from driftless.poses import rotation_matrices
from driftless.tracks import _logarithm


def quaternions(count, seed=1):
    values = np.random.default_rng(seed).normal(size=(count, 4))
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def exponential(vectors):
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.hstack([np.cos(angle / 2), np.sinc(angle / (2 * np.pi)) * vectors / 2])


def test_rotations_are_rotations_and_turn_as_quaternions_do():
    matrices = rotation_matrices(quaternions(50))
    assert np.allclose(matrices @ np.swapaxes(matrices, 1, 2), np.eye(3))
    assert np.allclose(np.linalg.det(matrices), 1)
    quarter = rotation_matrices(np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)]))  # about z
    assert np.allclose(quarter @ [1, 0, 0], [0, 1, 0])


def test_the_logarithm_inverts_the_exponential():
    vectors = np.random.default_rng(2).normal(size=(50, 3)) * np.array([[1e-9], [1e-3], [0.1], [0.5], [1.0]] * 10)
    assert np.allclose(_logarithm(rotation_matrices(exponential(vectors))), vectors, rtol=1e-7, atol=1e-12)


def test_a_message_is_read_back():
    pose = Pose(np.array([0.5, -0.5, 0.5, -0.5]), np.array([1.0, 2.0, 3.0]), np.diag([1.0, 2, 3, 4, 9, 16]))
    again = Pose.from_message(pose.to_message())
    assert np.array_equal(again.covariance, pose.covariance) and np.array_equal(again.matrix, pose.matrix)
    assert np.allclose(again.sigma_position, [2, 3, 4])


@pytest.mark.parametrize("value", [[1, 2], [1, 2, float("nan")], "far", None])
def test_a_damaged_pose_is_refused(value):
    with pytest.raises(Unreadable):
        Pose.from_message({"rotation_wxyz": [1, 0, 0, 0], "translation": value})


def test_tracks_are_interpolated_but_not_over_gaps():
    stamps = np.array([0, 100_000_000, 200_000_000, 1_000_000_000])
    vectors = np.array([[0, 0, 0], [0, 0, 0.2], [0, 0, 0.4], [0, 0, 0.5]])
    track = Track(stamps, np.outer(stamps, [1e-8, 0, 0]), exponential(vectors))
    inside, between = track.at(np.array([-1, 0, 50_000_000, 150_000_000, 600_000_000, 1_000_000_000, 1_000_000_001]))
    assert inside.tolist() == [False, True, True, True, False, True, False]
    assert np.allclose(between.translations[:, 0], [0, 0.5, 1.5, 10])
    assert np.allclose(_logarithm(rotation_matrices(between.rotations_wxyz))[:, 2], [0, 0.1, 0.3, 0.5])


def test_errors_are_those_that_were_put_in_and_the_covariance_scales_them():
    rng = np.random.default_rng(4)
    count, stamps = 4000, np.arange(4000) * 10_000_000
    covariance = np.diag([1e-4, 2e-4, 3e-4, 0.01, 0.04, 0.09])
    drawn = rng.multivariate_normal(np.zeros(6), covariance, count)
    truth = Track(stamps, np.zeros((count, 3)), np.tile([1.0, 0, 0, 0], (count, 1)))
    estimate = Track(stamps, -drawn[:, 3:], exponential(-drawn[:, :3]), np.tile(covariance, (count, 1, 1)))
    errors = estimate.errors(truth)
    assert np.allclose(errors.positions, drawn[:, 3:]) and np.allclose(errors.rotations, drawn[:, :3])
    assert abs(errors.nees.mean() - 1) < 0.05  # 4 sigma of 24,000 degrees of freedom are 0.037
    assert np.isclose(errors.rmse_position, np.sqrt(0.14), rtol=0.05)


def test_the_outline_of_an_ellipse_has_its_distance():
    covariance = np.array([[4.0, 1.0], [1.0, 2.0]])
    outline = ellipse(np.array([1.0, 2.0]), covariance) - [1.0, 2.0]
    distance = np.einsum("ni,ij,nj->n", outline, np.linalg.inv(covariance), outline)
    assert np.allclose(distance, 9)
