#!/usr/bin/env python3
"""Writes bytes and values of every message as real ROS 2 serializes them, for `tests/goldens.rs`.

python3.11 -m venv venv
venv/bin/pip install 'ros-jazzy-rclpy[fastrtps]' ros-wheels-bootstrapper rosbags \
    ros-jazzy-nav-msgs ros-jazzy-sensor-msgs ros-jazzy-geometry-msgs ros-jazzy-diagnostic-msgs ros-jazzy-rosgraph-msgs
AMENT_PREFIX_PATH=$PWD/venv RMW_IMPLEMENTATION=rmw_fastrtps_cpp venv/bin/python make_goldens.py

`TYPE.cdr` is what `rclpy.serialization` wrote, with padding zeroed (ROS leaves it uninitialized): a byte is padding if
`rclpy` reads the same message whatever the byte is. `TYPE.json` holds type, hash and values. The `rosbags` package, which
is independent of ROS, must write the same bytes and hashes; tf2_msgs has no wheel, so its golden is by `rosbags` alone.
"""

import importlib
import json
import os
from pathlib import Path

from rosbags.typesys import Stores, get_typestore

HERE = Path(__file__).parent
BY_RCLPY = [
    "sensor_msgs/msg/Imu", "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo",
    "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry", "diagnostic_msgs/msg/DiagnosticArray",
    "rosgraph_msgs/msg/Clock", "nav_msgs/msg/Path", "nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/JointState",
]  # fmt: skip
STORE = get_typestore(Stores.ROS2_JAZZY)


class Values:
    """Distinct values for the fields of a message, in order; texts and sequences of every length modulo 4."""

    def __init__(self):
        self.count = 0

    def next(self):
        self.count += 1
        return self.count

    def number(self, kind):
        count = self.next()
        if kind.startswith("float"):
            return (-1) ** count * (count + 1 / 1024)
        if kind == "bool":
            return True
        return {"int32": -1000003 * count, "uint32": 1000003 * count}.get(kind, count)

    def text(self):
        return "hé llo wörld"[: 1 + self.next() % 7]

    def length(self):
        return 2 + self.next() % 3


def fill(name, values):
    """The fields of a type as JSON values, by the definitions in `rosbags`."""
    fields = {}
    for field, description in STORE.get_msgdef(name).fields:
        fields[field] = fill_field(description, values)
    return fields


def fill_field(description, values):
    kind, detail = description[0].name, description[1]
    if kind == "NAME":
        return fill(detail, values)
    if kind == "BASE":
        return values.text() if detail[0] == "string" else values.number(detail[0])
    count = detail[1] if kind == "ARRAY" else values.length()
    return [fill_field(detail[0], values) for _ in range(count)]


def class_of(name):
    package, _, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), message)


def to_rclpy(name, fields):
    message = class_of(name)()
    for field, description in STORE.get_msgdef(name).fields:
        kind, detail, value = description[0].name, description[1], fields[field]
        if kind == "NAME":
            value = to_rclpy(detail, value)
        elif kind in ("ARRAY", "SEQUENCE") and detail[0][0].name == "NAME":
            value = [to_rclpy(detail[0][1], element) for element in value]
        elif detail[0] in ("octet", "byte"):
            value = bytes([value])
        setattr(message, field, value)
    return message


def comparable(message):
    if hasattr(message, "get_fields_and_field_types"):
        return [comparable(getattr(message, field)) for field in message.get_fields_and_field_types()]
    if hasattr(message, "tolist"):
        return [repr(element) for element in message.tolist()]
    return [comparable(element) for element in message] if isinstance(message, (list, tuple)) else repr(message)


def reads_the_same(message, cdr, at, flip):
    from rclpy.serialization import deserialize_message

    other = bytearray(cdr)
    other[at] ^= flip
    try:
        return comparable(deserialize_message(bytes(other), type(message))) == comparable(message)
    except Exception:  # ROS refuses the message: not padding
        return False


def by_rclpy(name, fields):
    from rclpy.serialization import deserialize_message, serialize_message

    message = to_rclpy(name, fields)
    cdr = bytearray(serialize_message(message))
    assert comparable(deserialize_message(bytes(cdr), type(message))) == comparable(message)
    padding = [at for at in range(4, len(cdr)) if all(reads_the_same(message, cdr, at, flip) for flip in (0x01, 0x80))]
    for at in padding:
        cdr[at] = 0
    package, _, short = name.split("/")
    definition = json.loads(next(Path(prefix()).rglob(f"share/{package}/msg/{short}.json")).read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in definition["type_hashes"]}
    return bytes(cdr), hashes[name]


def prefix():
    return os.environ["AMENT_PREFIX_PATH"].split(":")[0]


def to_rosbags(name, fields):
    import numpy

    arguments = {}
    for field, description in STORE.get_msgdef(name).fields:
        kind, detail, value = description[0].name, description[1], fields[field]
        if kind == "NAME":
            value = to_rosbags(detail, value)
        elif kind in ("ARRAY", "SEQUENCE"):
            if detail[0][0].name == "NAME":
                value = [to_rosbags(detail[0][1], element) for element in value]
            elif detail[0][1][0] != "string":
                value = numpy.array(value, dtype=detail[0][1][0])
        arguments[field] = value
    return STORE.types[name](**arguments)


def by_rosbags(name, fields):
    return bytes(STORE.serialize_cdr(to_rosbags(name, fields), name)), STORE.hash_rihs01(name)


def main():
    for name in [*BY_RCLPY, "tf2_msgs/msg/TFMessage"]:
        fields = fill(name, Values())
        cdr, type_hash = by_rosbags(name, fields)
        if name in BY_RCLPY:
            independent, cdr_length = cdr, len(cdr)
            cdr, rclpy_hash = by_rclpy(name, fields)
            differing = [at for at in range(cdr_length) if cdr[at] != independent[at]]
            assert not differing, f"{name}: rclpy and rosbags differ at {differing}"
            assert type_hash == rclpy_hash, f"{name}: {type_hash} is not {rclpy_hash}"
        stem = name.rsplit("/", 1)[1]
        (HERE / f"{stem}.cdr").write_bytes(cdr)
        golden = {"type": name, "hash": type_hash, "value": fields}
        (HERE / f"{stem}.json").write_text(json.dumps(golden, ensure_ascii=False) + "\n")
        print(name, len(cdr), "bytes", type_hash)


main()
