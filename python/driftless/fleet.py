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

FIRST_PATIENCE_S = 3.0
"""After so long without an answer a question is repeated."""

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
        """All maps that are served, by name: of each its newest version. Empty where no server answers within the timeout."""
        try:
            answers = self._ask("map/*/info", MapInfo.from_message)
        except NoAnswer:
            return []
        newest: dict[tuple[str, str], MapInfo] = {}
        for one in sorted(answers, key=lambda one: one.version):
            newest[one.name, one.identity] = one
        return sorted(newest.values(), key=lambda one: one.name)

    def info(self, map: str) -> MapInfo:
        """What a map is."""
        return self._ask(f"map/{_name(map)}/info", MapInfo.from_message)[0]

    def keyframe(self, map: str, id: int) -> Keyframe:
        """One keyframe of a map, with what it sees."""
        return self._ask(f"map/{_name(map)}/keyframes/{int(id)}", Keyframe.from_message)[0]

    def keyframes(self, map: str) -> list[Keyframe]:
        """All keyframes of a map, by id. `NoAnswer` where not all of them come within the timeout, which a large map needs a longer one for."""
        deadline = time.monotonic() + self.timeout_s
        key, received = f"map/{_name(map)}/keyframes/*", "no keyframe"
        while (left := deadline - time.monotonic()) > 0:
            wanted = self._ask(f"map/{_name(map)}/info", MapInfo.from_message, within_s=left)[0]
            if wanted.keyframes == 0:
                return []
            # A link that is lost ends the answer early, and a map that is replaced has other keyframes in the end.
            try:
                left = deadline - time.monotonic()
                answers = self._ask(key, Keyframe.from_message, within_s=left, is_long=True)
            except NoAnswer:
                break
            keyframes = {one.id: one for one in answers if one.map_version == wanted.version}
            if len(keyframes) == wanted.keyframes:
                return sorted(keyframes.values(), key=lambda one: one.id)
            received = f"{len(keyframes)} of {wanted.keyframes} keyframes"
            time.sleep(0.05)
        raise NoAnswer(f"{key}: {received} received within {self.timeout_s} s")

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

    def _ask(
        self,
        key: str,
        build: Callable[[Mapping[str, Any]], T],
        payload: str | None = None,
        *,
        within_s: float | None = None,
        is_long: bool = False,
    ) -> list[T]:
        """Asks until there is an answer, repeating what no server answered or what found it busy.

        Args:
            within_s: the timeout, where it is not that of the fleet.
            is_long: whether the answer may take the whole of it; else the question is repeated after 3, 6, 12 s.
        """
        within_s = self.timeout_s if within_s is None else within_s
        deadline = time.monotonic() + within_s
        pause, reason = 0.02, "no map server answered"
        patience_s = FIRST_PATIENCE_S
        while (left := deadline - time.monotonic()) > 0:
            answers: list[T] = []
            asked, wait_s = time.monotonic(), left if is_long else min(left, patience_s)
            replies = self._session.get(
                f"{key}?format=json;client={self._client};patience_ms={int(wait_s * 1000)}",
                payload=payload,
                encoding=None if payload is None else zenoh.Encoding.APPLICATION_JSON,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=wait_s,
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
            if time.monotonic() - asked >= wait_s:
                patience_s *= 2
            time.sleep(max(0.0, min(pause, deadline - time.monotonic())))
            pause = min(2 * pause, 0.5)
        raise NoAnswer(f"{key}: {reason}, within {within_s:.3g} s")


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
