"""Queries and subscriptions, against a real map server and a real robot."""

import json
import threading
import time

import numpy as np
import pytest

from driftless import DriftlessError, Fleet, NoAnswer, Refused, Unreadable
from driftless.messages import RobotStatus, decode
from driftless.subscription import Subscription


def test_maps_and_servers_are_listed(fleet):
    (place,) = fleet.maps()
    assert place.name == "place" and place.keyframes > 10 and place.landmarks > 100
    assert np.allclose(place.gravity_in_global, [0, 0, -1])
    assert fleet.info("place").identity == place.identity
    assert fleet.servers() == ["s1"] and fleet.robots() == []


def test_keyframes_come_with_what_they_see(fleet):
    keyframes = fleet.keyframes("place")
    info = fleet.info("place")
    assert [one.id for one in keyframes] == sorted(one.id for one in keyframes)
    assert len(keyframes) == info.keyframes and sum(len(one.landmarks) for one in keyframes) == info.observations
    first = keyframes[0]
    alone = fleet.keyframe("place", first.id)
    assert np.array_equal(alone.global_from_keyframe.matrix, first.global_from_keyframe.matrix)
    anchors = [one for one in keyframes if (one.anchors == one.id).any()]
    assert anchors, "every landmark is anchored in a keyframe that sees it"
    for one in anchors:
        assert (one.positions_in_anchor[one.anchors == one.id][:, 2] > 0).all()
    smallest, largest = info.extent
    assert (smallest <= first.global_from_keyframe.translation).all()
    assert (first.global_from_keyframe.translation <= largest).all()


def test_features_of_a_recording_are_localized(fleet, place):
    from driftless.tracks import read_euroc

    rows = (place / "place" / "live" / "mav0" / "cam0" / "features.csv").read_text().splitlines()[1:]
    rows = [row.split(",") for row in rows]
    stamp = rows[len(rows) // 2][0]
    seen = [row for row in rows if row[0] == stamp]
    info, camera = fleet.info("place"), fleet.keyframes("place")[0].camera
    request = {
        "schema": 10,
        "camera": camera,
        "features": {
            "pixels": [[float(row[1]), float(row[2])] for row in seen],
            "descriptors": {"kind": "binary", "width": len(seen[0][3]) // 2, "hex": [row[3] for row in seen]},
            "extractor": info.extractor,
        },
    }
    found = fleet.localize("place", request, gravity_in_camera=None)
    assert found.outcome == "matched" and found.inliers > 10 and found.map_identity == info.identity
    truth = read_euroc(place / "place" / "live" / "mav0" / "state_groundtruth_estimate0" / "data.csv")
    inside, body = truth.at(np.array([int(stamp)]))
    assert inside.all()
    distance = np.linalg.norm(found.global_from_camera.translation - body.translations[0])
    assert distance < 1.0 + 3 * np.linalg.norm(found.global_from_camera.sigma_position)  # the camera is not the IMU
    prior = fleet.localize("place", request, prior_global_from_camera=found.global_from_camera)
    assert prior.outcome == "matched"


def test_an_image_of_elsewhere_is_not_localized(fleet, place):
    noise = np.random.default_rng(1).integers(0, 255, (480, 752), dtype=np.uint8)
    camera = place / "place" / "live" / "mav0" / "cam0" / "sensor.yaml"
    with pytest.raises(DriftlessError):  # the simulated map's features are of no extractor
        fleet.localize("place", noise, camera)


def test_refusals_are_in_words(fleet):
    with pytest.raises(Refused, match="bad_request") as caught:
        fleet.localize("place", {"schema": 10, "camera": {}})
    assert caught.value.code == "bad_request"
    with pytest.raises(DriftlessError, match="no name of a map"):
        fleet.info("place/*")
    with pytest.raises(DriftlessError, match="camera"):
        fleet.localize("place", "query.png")


def test_what_nobody_serves_ends_at_the_deadline(endpoint, fleet):
    with Fleet(endpoint, timeout_s=0.5) as impatient:
        begin = time.monotonic()
        with pytest.raises((NoAnswer, Refused)):
            impatient.info("cellar")
        assert time.monotonic() - begin < 3
    with pytest.raises(NoAnswer, match="is the map server or router running"):
        Fleet("tcp/127.0.0.1:9")
    with pytest.raises(DriftlessError, match="write tcp/127.0.0.1:7447"):
        Fleet("127.0.0.1:7447")


def test_a_robot_is_heard(fleet, robot):
    with fleet.poses(robot) as poses, fleet.odometry() as odometry, fleet.status(robot) as status:
        pose = poses.next(timeout_s=30)
        assert pose is not None and pose.robot == "r7" and pose.map == "place"
        assert pose.global_from_imu.sigma_position.max() < 5
        assert odometry.next(timeout_s=5).robot == "r7"
        assert status.latest(timeout_s=5).state in {"starting", "odometry_only", "localized"}
        assert fleet.robots() == ["r7"]
        later = poses.latest(timeout_s=5)
        assert later.stamp_ns > pose.stamp_ns and poses.unreadable == 0


def test_a_subscription_keeps_the_newest_and_ends():
    class Declared:
        def undeclare(self):
            pass

    senders = []
    subscription = Subscription(lambda receive: (senders.append(receive), Declared())[1], capacity=3)
    for number in range(5):
        senders[0](number)
    senders[0](Unreadable("noise"))
    assert subscription.dropped == 2 and subscription.unreadable == 1
    assert subscription.next() == 2 and subscription.latest() == 4 and subscription.next(timeout_s=0.01) is None
    waiting = threading.Thread(target=lambda: list(subscription))
    waiting.start()
    subscription.close()
    waiting.join(5)
    assert not waiting.is_alive()


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b"\xff", "no message"),
        (b"[]", "no message"),
        (b'{"schema": 3}', "schema 3, this package uses 10"),
        (b'{"schema": 12}', "schema 12, this package uses 10"),
        (b'{"schema": 11, "stamp_ns": 1, "floor": 3}', "'state' is missing"),
        (b'{"schema": 9, "stamp_ns": 1}', "'state' is missing"),
    ],
)
def test_hostile_messages_are_named(payload, says):
    with pytest.raises(Unreadable, match=says):
        decode(payload, "robot/r7/status", RobotStatus.from_message)


def test_examples_of_the_wire_are_read():
    from pathlib import Path

    from driftless import messages

    examples = Path(__file__).parents[2] / "protocol" / "examples" / "json"
    builders = {
        "map_info_reply": messages.MapInfo,
        "keyframe_reply": messages.Keyframe,
        "localize_reply": messages.Localization,
        "robot_pose": messages.RobotPose,
        "robot_odometry": messages.RobotOdometry,
        "robot_status": messages.RobotStatus,
    }
    for name, builder in builders.items():
        text = (examples / f"{name}.json").read_bytes()
        assert decode(text, name, builder.from_message) is not None
        for field in json.loads(text):
            without = {key: value for key, value in json.loads(text).items() if key != field}
            try:
                decode(json.dumps(without), name, builder.from_message)
            except Unreadable as error:
                assert field in str(error)
