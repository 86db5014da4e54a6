"""A rigid transform with its covariance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import Unreadable

Array = NDArray[np.float64]


def rotation_matrices(quaternions_wxyz: Array) -> Array:
    """Rotation matrices, shape (..., 3, 3), of unit quaternions, shape (..., 4), w first."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions_wxyz, float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), [0, 1], [-2, -1])


@dataclass(frozen=True, eq=False)
class Pose:
    """A transform parent_from_child: where the child frame is in the parent frame."""

    rotation_wxyz: Array
    """Hamilton quaternion, w first, shape (4,)."""
    translation: Array
    """Position of the child's origin in the parent frame, m, shape (3,)."""
    covariance: Array | None = None
    """Covariance of [dtheta, dp] in the parent frame, rad and m, shape (6, 6)."""

    @property
    def rotation(self) -> Array:
        """Rotation matrix, shape (3, 3)."""
        return rotation_matrices(self.rotation_wxyz)

    @property
    def matrix(self) -> Array:
        """Homogeneous matrix, shape (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    @property
    def sigma_position(self) -> Array:
        """Standard deviations of the position along the parent's axes, m, shape (3,)."""
        return np.sqrt(np.diag(self._known_covariance())[3:])

    @property
    def sigma_rotation(self) -> Array:
        """Standard deviations of the rotation about the parent's axes, rad, shape (3,)."""
        return np.sqrt(np.diag(self._known_covariance())[:3])

    def _known_covariance(self) -> Array:
        if self.covariance is None:
            raise Unreadable("this pose has no covariance")
        return self.covariance

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> Pose:
        """A pose as it is in JSON messages."""
        covariance = message.get("covariance")
        return cls(
            numbers(message["rotation_wxyz"], (4,)),
            numbers(message["translation"], (3,)),
            None if covariance is None else numbers(covariance, (6, 6)),
        )

    def to_message(self) -> dict[str, Any]:
        """The pose as it is in JSON messages."""
        message: dict[str, Any] = {
            "rotation_wxyz": np.asarray(self.rotation_wxyz).tolist(),
            "translation": np.asarray(self.translation).tolist(),
        }
        if self.covariance is not None:
            message["covariance"] = np.asarray(self.covariance).tolist()
        return message


def numbers(values: Any, shape: tuple[int, ...]) -> Array:
    """Finite numbers of a given shape, or `Unreadable`."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise Unreadable(f"numbers of shape {shape} expected: {error}") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise Unreadable(f"finite numbers of shape {shape} expected, shape {array.shape} found")
    return array
