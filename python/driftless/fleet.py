"""A fleet, seen from outside: its maps and its robots."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, TypeVar

import numpy as np
import zenoh

from .errors import DriftlessError, NoAnswer, Refused, Unreadable
from .features import extract_features
from .messages import Keyframe, Localization, MapInfo, RobotOdometry, RobotPose, RobotStatus, decode
from .poses import Pose
from .session import open_session
from .subscription import Subscription

T = TypeVar("T")

_FORBIDDEN = set("/*$#?@")


class Fleet:
    """A Zenoh session with the queries of Driftless. Use it as a context manager, or call `close`.

    Args:
        connect: endpoint of a map server or a router, `tcp/127.0.0.1:7447` by default.
        secure: folder of an operator of a secured fleet, as `driftless fleet init` writes it.
        zenoh_config: a Zenoh configuration, JSON5.
        namespace: prefix of all keys; one namespace is one fleet.
        timeout_s: how long a query may take, with its repetitions.
    """

    def __init__(
        self,
        connect: str | None = None,
        *,
        secure: str | PathLike[str] | None = None,
        zenoh_config: str | PathLike[str] | None = None,
        namespace: str | None = None,
        timeout_s: float = 5.0,
    ):
        if not timeout_s > 0:
            raise DriftlessError(f"timeout_s is {timeout_s}: give a positive number of seconds")
        self.timeout_s = timeout_s
        self._session = open_session(connect, secure, zenoh_config, namespace)
        # The server gives each session that is connected to it a share of its own.
        self._client = str(self._session.info.zid())

    def close(self) -> None:
        """Closes the session."""
        session: Any = self._session  # whose stub leaves out what it returns
        session.close()

    def __enter__(self) -> Fleet:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Maps

    def maps(self) -> list[MapInfo]:
        """All maps that are served, by name. Empty where no server answers within the timeout."""
        try:
            return sorted(self._ask("map/*/info", MapInfo.from_message), key=lambda one: one.name)
        except NoAnswer:
            return []

    def info(self, map: str) -> MapInfo:
        """What a map is."""
        return self._ask(f"map/{_name(map)}/info", MapInfo.from_message)[0]

    def keyframe(self, map: str, id: int) -> Keyframe:
        """One keyframe of a map, with what it sees."""
        return self._ask(f"map/{_name(map)}/keyframes/{int(id)}", Keyframe.from_message)[0]

    def keyframes(self, map: str) -> list[Keyframe]:
        """All keyframes of a map, by id. Give a large map a `timeout_s` that suffices to send it."""
        return sorted(self._ask(f"map/{_name(map)}/keyframes/*", Keyframe.from_message), key=lambda one: one.id)

    def localize(
        self,
        map: str,
        image: str | PathLike[str] | np.ndarray | Mapping[str, Any],
        camera: str | PathLike[str] | None = None,
        *,
        prior_global_from_camera: Pose | None = None,
        gravity_in_camera: np.ndarray | None = None,
    ) -> Localization:
        """Where a camera was in a map.

        Args:
            map: its name.
            image: a file, gray levels (height, width) of type uint8, or what `extract_features` returned.
            camera: sensor.yaml or Kalibr's camera chain of the camera that took the image.
            prior_global_from_camera: about where, with covariance.
            gravity_in_camera: unit vector, where it is known.
        """
        if isinstance(image, Mapping):
            request = dict(image)
        elif camera is None:
            raise DriftlessError("camera: name the sensor.yaml of the camera that took the image")
        else:
            request = extract_features(image, camera, extractor=self.info(map).extractor)
        if prior_global_from_camera is not None:
            request["prior"] = {"global_from_camera": prior_global_from_camera.to_message()}
        if gravity_in_camera is not None:
            request["gravity_in_camera"] = np.asarray(gravity_in_camera, float).tolist()
        return self._ask(f"map/{_name(map)}/localize", Localization.from_message, json.dumps(request))[0]

    # Robots

    def robots(self) -> list[str]:
        """Names of the robots that are there."""
        return self._alive("robot/*")

    def servers(self) -> list[str]:
        """Names of the map servers that are there."""
        return self._alive("map_server/*")

    def poses(self, robot: str = "*", capacity: int = 1000) -> Subscription[RobotPose]:
        """Poses of a robot in the map, or of all robots."""
        return self._subscribe(robot, "pose", RobotPose.from_message, capacity)

    def odometry(self, robot: str = "*", capacity: int = 1000) -> Subscription[RobotOdometry]:
        """Odometry of a robot, or of all robots."""
        return self._subscribe(robot, "odometry", RobotOdometry.from_message, capacity)

    def status(self, robot: str = "*", capacity: int = 1000) -> Subscription[RobotStatus]:
        """Status of a robot, or of all robots."""
        return self._subscribe(robot, "status", RobotStatus.from_message, capacity)

    def _subscribe(
        self, robot: str, topic: str, build: Callable[[Mapping[str, Any]], T], capacity: int
    ) -> Subscription[T]:
        key = f"robot/{robot if robot == '*' else _name(robot)}/{topic}"

        def declare(receive: Callable[[Any], None]) -> Any:
            def received(sample: zenoh.Sample) -> None:
                try:
                    message = _decode_sample(sample, build)
                    object.__setattr__(message, "robot", str(sample.key_expr).split("/")[-2])
                except Unreadable as error:
                    receive(error)
                else:
                    receive(message)

            return self._session.declare_subscriber(key, received)

        return Subscription(declare, capacity)

    def _alive(self, key: str) -> list[str]:
        replies = self._session.liveliness().get(key, timeout=self.timeout_s)
        return sorted({str(reply.ok.key_expr).split("/")[-1] for reply in replies if reply.ok is not None})

    # Queries

    def _ask(self, key: str, build: Callable[[Mapping[str, Any]], T], payload: str | None = None) -> list[T]:
        """Asks until there is an answer, repeating what no server answered or what found it busy."""
        deadline = time.monotonic() + self.timeout_s
        pause, reason = 0.02, "no map server answered"
        while (left := deadline - time.monotonic()) > 0:
            answers: list[T] = []
            replies = self._session.get(
                f"{key}?format=json;client={self._client};patience_ms={int(left * 1000)}",
                payload=payload,
                encoding=None if payload is None else zenoh.Encoding.APPLICATION_JSON,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=left,
            )
            busy = False
            for reply in replies:
                if reply.ok is not None:
                    answers.append(_decode_sample(reply.ok, build))
                    continue
                error = _refusal(reply.err, key)
                if error is None:
                    continue
                if error.code != "busy":
                    raise error
                busy, reason = True, "the server was busy throughout"
            if answers and not busy:
                return answers
            time.sleep(max(0.0, min(pause, deadline - time.monotonic())))
            pause = min(2 * pause, 0.5)
        raise NoAnswer(f"{key}: {reason}, within {self.timeout_s} s")


def _decode_sample(sample: Any, build: Callable[[Mapping[str, Any]], T]) -> T:
    what = str(sample.key_expr)
    if "json" not in str(sample.encoding):
        raise Unreadable(f"{what} is sent as {sample.encoding}: start onboard without --topics bincode")
    return decode(sample.payload.to_bytes(), what, build)


def _refusal(error: Any, key: str) -> Refused | None:
    """A server's refusal; `None` for what Zenoh itself says, as on a timeout."""
    try:
        message = json.loads(error.payload.to_bytes())
        return Refused(str(message["code"]), f"{key}: {message['message']}")
    except (KeyError, TypeError, UnicodeDecodeError, ValueError):
        return None


def _name(name: str) -> str:
    """Checks that a name can be one chunk of a key."""
    if not name or any(one in _FORBIDDEN or one.isspace() for one in name):
        raise DriftlessError(f"{name!r} is no name of a map or robot: use letters, digits, '-', '_' and '.'")
    return name
