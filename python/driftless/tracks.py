"""Trajectories as arrays, and their errors against a ground truth."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import Unreadable
from .poses import Array, Pose, rotation_matrices

MAX_GAP_NS = 250_000_000
"""A ground truth is interpolated over gaps up to this length, as `driftless evaluate` does."""


@dataclass(frozen=True, eq=False)
class Track:
    """Poses parent_from_child over time."""

    stamps_ns: NDArray[np.int64]
    """Shape (n,), ascending."""
    translations: Array
    """m, shape (n, 3)."""
    rotations_wxyz: Array
    """Shape (n, 4)."""
    covariances: Array | None = None
    """Of [dtheta, dp] in the parent frame, shape (n, 6, 6)."""

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __getitem__(self, index: int) -> Pose:
        covariance = None if self.covariances is None else self.covariances[index]
        return Pose(self.rotations_wxyz[index], self.translations[index], covariance)

    @property
    def seconds(self) -> Array:
        """Time since the first pose, s, shape (n,)."""
        return (self.stamps_ns - self.stamps_ns[:1]).astype(np.float64) * 1e-9

    @property
    def sigma_positions(self) -> Array:
        """Standard deviations of the positions, m, shape (n, 3)."""
        if self.covariances is None:
            raise Unreadable("these poses have no covariances")
        sigmas: Array = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)[:, 3:])
        return sigmas

    def at(self, stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.bool_], Track]:
        """Interpolates at other times.

        Returns:
            Which times lie within the track and in no gap longer than `MAX_GAP_NS`, and the poses at those.
        """
        after = np.searchsorted(self.stamps_ns, stamps_ns, side="left")
        inside = after < len(self)
        after = np.minimum(after, len(self) - 1)
        exact = self.stamps_ns[after] == stamps_ns
        inside &= exact | (after > 0)
        before = np.where(exact, after, np.maximum(after - 1, 0))
        gap = self.stamps_ns[after] - self.stamps_ns[before]
        inside &= gap <= MAX_GAP_NS
        before, after, gap = before[inside], after[inside], gap[inside]
        fraction = ((stamps_ns[inside] - self.stamps_ns[before]) / np.maximum(gap, 1))[:, None]
        translations = (1 - fraction) * self.translations[before] + fraction * self.translations[after]
        rotations = _slerp(self.rotations_wxyz[before], self.rotations_wxyz[after], fraction)
        return inside, Track(stamps_ns[inside], translations, rotations)

    def moved(self, rotation_wxyz: Array, translation: Array) -> Track:
        """The same poses in another parent frame, which holds this one at the given pose."""
        rotation = rotation_matrices(np.asarray(rotation_wxyz, float))
        covariances = self.covariances
        if covariances is not None:
            both = np.kron(np.eye(2), rotation)
            covariances = both @ covariances @ both.T
        translations = self.translations @ rotation.T + np.asarray(translation, float)
        return Track(self.stamps_ns, translations, _product(rotation_wxyz, self.rotations_wxyz), covariances)

    def errors(self, truth: Track | None) -> Errors:
        """Errors against a ground truth in the same frame; poses without truth are left out."""
        if truth is None:
            raise Unreadable("there is no ground truth: the recording has none, or is not where the run names it")
        inside, reference = truth.at(self.stamps_ns)
        if not inside.any():
            raise Unreadable("the ground truth covers none of these times")
        estimated = rotation_matrices(self.rotations_wxyz[inside])
        rotation = _logarithm(rotation_matrices(reference.rotations_wxyz) @ np.swapaxes(estimated, 1, 2))
        position = reference.translations - self.translations[inside]
        covariances = None if self.covariances is None else self.covariances[inside]
        return Errors(self.stamps_ns[inside], rotation, position, covariances)


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors over time, truth minus estimate, in the parent frame."""

    stamps_ns: NDArray[np.int64]
    rotations: Array
    """Rotation vectors, rad, shape (n, 3)."""
    positions: Array
    """m, shape (n, 3)."""
    covariances: Array | None

    @property
    def rmse_position(self) -> float:
        """Root mean square error of the position, m."""
        return float(np.sqrt((self.positions**2).sum(axis=1).mean()))

    @property
    def rmse_rotation(self) -> float:
        """Root mean square error of the rotation, rad."""
        return float(np.sqrt((self.rotations**2).sum(axis=1).mean()))

    @property
    def nees(self) -> Array:
        """Squared errors in units of the covariance, per degree of freedom, shape (n,); 1 on average is consistent."""
        if self.covariances is None:
            raise Unreadable("these poses have no covariances")
        errors = np.hstack([self.rotations, self.positions])
        whitened = np.linalg.solve(self.covariances, errors[..., None])[..., 0]
        nees: Array = np.einsum("ni,ni->n", errors, whitened) / 6
        return nees


def read_states(path: str | PathLike[str]) -> dict[str, Track]:
    """Reads a states.csv: `global_from_imu`, `local_from_imu`, `global_from_local`, those that it has.

    A last row that is cut off, as when a run was killed, is left out.
    """
    by_state: dict[str, list[tuple[int, list[float]]]] = {}
    rows = list(_rows(path))
    for number, row in enumerate(rows):
        try:
            if len(row) != 30:
                raise ValueError(f"30 columns expected, {len(row)} found")
            values = [float(value) for value in row[2:]]
            by_state.setdefault(row[1].strip(), []).append((int(row[0]), values))
        except ValueError as error:
            if number + 1 < len(rows):
                raise Unreadable(f"{path}, row {number + 1}: {error}") from error
    if not by_state:
        raise Unreadable(f"{path} has no states")
    return {state: _track_with_covariances(values) for state, values in by_state.items()}


def read_euroc(path: str | PathLike[str]) -> Track:
    """Reads a ground truth in EuRoC's layout: `timestamp [ns], p, q (w first), ...`."""
    return _track(path, _rows(path), int, rotation=slice(4, 8), translation=slice(1, 4))


def read_tum(path: str | PathLike[str]) -> Track:
    """Reads a TUM file: `t [s] x y z qx qy qz qw`."""
    with open(path, encoding="utf-8") as file:
        rows = [line.split() for line in file if line.strip() and not line.startswith("#")]
    return _track(path, rows, _nanoseconds, rotation=[7, 4, 5, 6], translation=slice(1, 4))


def _nanoseconds(seconds: str) -> int:
    whole, _, fraction = seconds.partition(".")
    return int(whole) * 10**9 + int(fraction[:9].ljust(9, "0"))


def _track(
    path: str | PathLike[str],
    rows: Iterable[list[str]],
    stamp: Callable[[str], int],
    *,
    rotation: slice | list[int],
    translation: slice,
) -> Track:
    stamps: list[int] = []
    values: list[list[float]] = []
    for number, row in enumerate(rows):
        try:
            stamps.append(stamp(row[0]))
            values.append([float(value) for value in row[1:8]])
            if len(values[-1]) != 7:
                raise ValueError("a time and a pose expected")
        except (ValueError, IndexError) as error:
            raise Unreadable(f"{path}, row {number + 1}: {error}") from error
    if not values:
        raise Unreadable(f"{path} has no poses")
    numbers = np.hstack([np.zeros((len(values), 1)), np.array(values)])  # columns as in the file
    return Track(np.array(stamps, dtype=np.int64), numbers[:, translation], numbers[:, rotation])


def _track_with_covariances(rows: list[tuple[int, list[float]]]) -> Track:
    stamps = np.array([stamp for stamp, _ in rows], dtype=np.int64)
    values = np.array([row for _, row in rows])
    upper = np.triu_indices(6)
    covariances = np.zeros((len(rows), 6, 6))
    covariances[:, upper[0], upper[1]] = values[:, 7:]
    covariances[:, upper[1], upper[0]] = values[:, 7:]
    return Track(stamps, values[:, :3], values[:, 3:7], covariances)


def _rows(path: str | PathLike[str]) -> Iterator[list[str]]:
    with open(Path(path), encoding="utf-8", newline="") as file:
        for row in csv.reader(file):
            if row and not row[0].startswith("#"):
                yield row


def _product(first: Array, second: Array) -> Array:
    """Products of a quaternion, shape (4,), with others, shape (n, 4), w first."""
    w, x, y, z = np.asarray(first, float)
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    product: Array = np.asarray(second, float) @ left.T
    return product


def _slerp(first: Array, second: Array, fraction: Array) -> Array:
    cosine = np.sum(first * second, axis=1, keepdims=True)
    second = np.where(cosine < 0, -second, second)
    angle = np.arccos(np.clip(np.abs(cosine), -1, 1))
    near = angle < 1e-6  # where the sine vanishes, the line is the arc
    sine = np.where(near, 1, np.sin(angle))
    first_weight = np.where(near, 1 - fraction, np.sin((1 - fraction) * angle) / sine)
    second_weight = np.where(near, fraction, np.sin(fraction * angle) / sine)
    between = first_weight * first + second_weight * second
    unit: Array = between / np.linalg.norm(between, axis=1, keepdims=True)
    return unit


def _logarithm(rotations: Array) -> Array:
    """Rotation vectors, shape (n, 3), of rotation matrices."""
    axis = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(axis, axis=1) / 2
    cosine = (np.trace(rotations, axis1=1, axis2=2) - 1) / 2
    angle = np.arctan2(sine, cosine)
    return axis / 2 * np.where(sine < 1e-12, 1, angle / np.maximum(sine, 1e-12))[:, None]
