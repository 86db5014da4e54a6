"""Messages of servers and robots, decoded from JSON. The wire reference explains each field."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import Unreadable
from .poses import Array, Pose, numbers

SCHEMA = 10
"""Version of the messages that this package writes. It reads those of the version before and after as well."""
OLDEST_SCHEMA = 8
"""The first version that is read: those before were never released."""

T = TypeVar("T")


def decode(payload: bytes | str, what: str, build: Callable[[Mapping[str, Any]], T]) -> T:
    """Decodes one JSON message; `Unreadable` says what it should have been."""
    try:
        message = json.loads(payload)
        schema = message["schema"]
        if not max(OLDEST_SCHEMA, SCHEMA - 1) <= schema <= SCHEMA + 1:
            raise Unreadable(f"schema {schema}, this package uses {SCHEMA}: update the older of package and server")
        return build(message)
    except Unreadable as error:
        raise Unreadable(f"{what}: {error}") from error
    except KeyError as error:
        raise Unreadable(f"{what}: the field {error} is missing") from error
    except (AttributeError, TypeError, UnicodeDecodeError, ValueError) as error:
        raise Unreadable(f"{what} is no message of Driftless: {error}") from error


@dataclass(frozen=True)
class FeatureKind:
    """A kind of features of a map: a query with it is answered with its landmarks."""

    extractor: str
    """Empty where it is not known."""
    descriptor_kind: str
    """`binary`, `float` or `int8`."""
    descriptor_bytes: int
    landmarks: int
    observations: int

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> FeatureKind:
        return cls(
            extractor=message["extractor"],
            descriptor_kind=message["descriptors"]["kind"],
            descriptor_bytes=message["descriptors"]["width"],
            landmarks=message["landmarks"],
            observations=message["observations"],
        )


@dataclass(frozen=True, eq=False)
class MapInfo:
    """What a served map is."""

    name: str
    version: int
    identity: str
    keyframes: int
    landmarks: int
    observations: int
    extractor: str
    """Of the first kind of features; queries may have another one of `feature_kinds`."""
    extent: tuple[Array, Array] | None
    """Smallest and largest coordinates of its keyframes, m."""
    gravity_in_global: Array | None
    """Unit vector; `None` where the map does not state it."""
    feature_kinds: tuple[FeatureKind, ...]
    """The kinds of features that queries may have; empty where an older server does not state them."""

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> MapInfo:
        extent, gravity = message.get("extent"), message.get("gravity_in_global")
        return cls(
            name=message["name"],
            version=message["version"],
            identity=message["identity"],
            keyframes=message["keyframes"],
            landmarks=message["landmarks"],
            observations=message["observations"],
            extractor=message["extractor"],
            extent=None if extent is None else (numbers(extent["min"], (3,)), numbers(extent["max"], (3,))),
            gravity_in_global=None if gravity is None else numbers(gravity, (3,)),
            feature_kinds=tuple(FeatureKind.from_message(kind) for kind in message.get("feature_kinds", ())),
        )


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A keyframe with the landmarks that it sees."""

    id: int
    stamp_ns: int
    global_from_keyframe: Pose
    camera: Mapping[str, Any]
    """Size, focal lengths, centre and distortion, as in messages."""
    map_version: int
    map_identity: str
    landmarks: NDArray[np.int64]
    """Ids, shape (n,)."""
    anchors: NDArray[np.int64]
    """The keyframes in whose camera frames the positions are, shape (n,)."""
    positions_in_anchor: Array
    """m, shape (n, 3)."""
    pixels: Array
    """Where this keyframe sees them, distorted px, shape (n, 2)."""

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> Keyframe:
        keyframe, seen = message["keyframe"], message["landmarks"]
        return cls(
            id=keyframe["id"],
            stamp_ns=keyframe["stamp_ns"],
            global_from_keyframe=Pose.from_message(keyframe["global_from_keyframe"]),
            camera=keyframe["camera"],
            map_version=message["map_version"],
            map_identity=message["map_identity"],
            landmarks=np.array([one["landmark"] for one in seen], dtype=np.int64),
            anchors=np.array([one["anchor"] for one in seen], dtype=np.int64),
            positions_in_anchor=numbers([one["position_in_anchor"] for one in seen] or np.empty((0, 3)), (len(seen), 3)),
            pixels=numbers([one["pixel"] for one in seen] or np.empty((0, 2)), (len(seen), 2)),
        )


@dataclass(frozen=True, eq=False)
class PossiblePlace:
    """A place that an image could be of."""

    global_from_camera: Pose
    features: int
    """Features of the image that landmarks of the place explain."""
    log_odds: float
    """Natural logarithm of the odds of this place against another one that looks alike in part."""

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> PossiblePlace:
        return cls(Pose.from_message(message["global_from_camera"]), message["features"], message["log_odds"])


@dataclass(frozen=True, eq=False)
class Localization:
    """What a map says of one image."""

    outcome: str
    """`matched`, `no_match`, `not_verified`, `too_few_features`, `ambiguous` or `empty_map`."""
    map_version: int
    map_identity: str
    global_from_camera: Pose | None
    """`None` unless matched."""
    keyframe: int | None = None
    """The keyframe with most inliers."""
    matched_features: int = 0
    inliers: int = 0
    mean_error_px: float | None = None
    places: tuple[PossiblePlace, ...] = ()
    """The places that explain the image, the one that explains most of it first."""

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> Localization:
        head = (message["outcome"], message["map_version"], message["map_identity"])
        fix = message.get("fix")
        places = tuple(PossiblePlace.from_message(place) for place in message.get("places", ()))
        if fix is None:
            return cls(*head, global_from_camera=None, places=places)
        return cls(
            *head,
            global_from_camera=Pose.from_message(fix["global_from_camera"]),
            keyframe=fix["keyframe"],
            matched_features=fix["matched_features"],
            inliers=fix["inliers"],
            mean_error_px=fix["mean_error_px"],
            places=places,
        )


@dataclass(frozen=True, eq=False)
class RobotPose:
    """The pose of a robot in the map."""

    stamp_ns: int
    map: str
    map_version: int
    map_identity: str
    global_from_imu: Pose
    global_from_local: Pose
    robot: str = ""

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> RobotPose:
        return cls(
            stamp_ns=message["stamp_ns"],
            map=message["map"],
            map_version=message["map_version"],
            map_identity=message["map_identity"],
            global_from_imu=Pose.from_message(message["global_from_imu"]),
            global_from_local=Pose.from_message(message["global_from_local"]),
        )


@dataclass(frozen=True, eq=False)
class RobotOdometry:
    """The odometry of a robot in the estimator's frame L, which drifts slowly.

    The pose jumps where the map or GNSS corrects it, and L is another frame after a divergence. Continuous is the topic `odometry` of ROS 2.
    """

    stamp_ns: int
    local_from_imu: Pose
    velocity_in_local: Array
    """m/s."""
    angular_velocity_in_imu: Array
    """rad/s."""
    robot: str = ""

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> RobotOdometry:
        return cls(
            message["stamp_ns"],
            Pose.from_message(message["local_from_imu"]),
            numbers(message["velocity_in_local"], (3,)),
            numbers(message["angular_velocity_in_imu"], (3,)),
        )


@dataclass(frozen=True, eq=False)
class RobotStatus:
    """The state of a robot, and why."""

    stamp_ns: int
    state: str
    """`starting`, `odometry_only`, `localized`, `lost`, or `off`: the last status of a robot that shut down in order"""
    reason: str
    map: str | None
    last_map_update_ns: int | None
    keyframes_held: int
    queries_sent: int
    queries_answered: int
    robot: str = ""

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> RobotStatus:
        return cls(
            stamp_ns=message["stamp_ns"],
            state=message["state"],
            reason=message["reason"],
            map=message.get("map"),
            last_map_update_ns=message.get("last_map_update_ns"),
            keyframes_held=message["keyframes_held"],
            queries_sent=message["queries_sent"],
            queries_answered=message["queries_answered"],
        )
