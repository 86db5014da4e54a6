"""A map on topics of ROS 2, read by the package rosbags, equals the map and its files."""

import re
import socket
import subprocess
import time

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
POINTS, GRID = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/OccupancyGrid"


def key(topic, name):
    package, _, short = name.split("/")
    return f"0/{topic}/{package}::msg::dds_::{short}_/{STORE.hash_rihs01(name)}"


@pytest.fixture(scope="module")
def received(program, place):
    """The payloads of both topics, by type."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    messages = {}
    with zenoh.open(config) as session:
        subscribers = [
            session.declare_subscriber(
                key(topic, name), lambda sample, name=name: messages.setdefault(name, sample.payload.to_bytes())
            )
            for topic, name in (("map_points", POINTS), ("map", GRID))
        ]
        arguments = ["ros2-map", "--map", "place.db", "--camera-height", "1.5", "--ros2-connect", endpoint]
        publishing = subprocess.Popen([program("driftless"), *arguments], cwd=place, stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 30
        while len(messages) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        publishing.terminate()
        publishing.wait(10)
        assert len(messages) == 2, messages.keys()
        for subscriber in subscribers:
            subscriber.undeclare()
    return messages


def test_points_are_the_landmarks(received, fleet):
    cloud = STORE.deserialize_cdr(received[POINTS], POINTS)
    assert [(field.name, field.offset, field.datatype) for field in cloud.fields] == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]
    assert (cloud.header.frame_id, cloud.height, cloud.point_step, cloud.is_dense) == ("map", 1, 12, True)
    points = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(cloud.width, 3)
    expected = {}
    poses = {one.id: one.global_from_keyframe.matrix for one in fleet.keyframes("place")}
    for one in fleet.keyframes("place"):
        for landmark, anchor, position in zip(one.landmarks, one.anchors, one.positions_in_anchor):
            expected[int(landmark)] = poses[int(anchor)][:3] @ np.append(position, 1.0)
    assert cloud.width == len(expected) == fleet.info("place").landmarks
    in_order = np.array([expected[landmark] for landmark in sorted(expected)])
    assert np.abs(points - in_order).max() < 1e-4


def test_the_grid_is_that_of_the_files(received, program, place, tmp_path):
    arguments = ["occupancy-grid", "--map", "place.db", "--camera-height", "1.5", "--out", str(tmp_path)]
    subprocess.run([program("driftless"), *arguments], cwd=place, check=True, stdout=subprocess.DEVNULL)
    text = (tmp_path / "map.yaml").read_text(encoding="utf-8")
    value = {line.split(": ")[0]: line.split(": ")[1] for line in text.splitlines()}
    magic, width, height, most, pixels = re.match(
        rb"(P5)\n(\d+) (\d+)\n(\d+)\n(.*)", (tmp_path / value["image"]).read_bytes(), re.DOTALL
    ).groups()
    assert (magic, most) == (b"P5", b"255")
    occupied = (255 - np.flipud(np.frombuffer(pixels, np.uint8).reshape(int(height), int(width)))) / 255
    above, below = float(value["occupied_thresh"]), float(value["free_thresh"])
    of_files = np.where(occupied > above, 100, np.where(occupied < below, 0, -1))

    grid = STORE.deserialize_cdr(received[GRID], GRID)
    assert grid.header.frame_id == "map" and grid.info.resolution == np.float32(value["resolution"])
    assert (grid.info.width, grid.info.height) == (int(width), int(height))
    origin = [grid.info.origin.position.x, grid.info.origin.position.y, grid.info.origin.position.z]
    assert origin == [float(number) for number in value["origin"].strip("[]").split(",")]
    assert np.array_equal(grid.data.reshape(int(height), int(width)), of_files)
    assert {-1, 0, 100} == set(np.unique(of_files))
