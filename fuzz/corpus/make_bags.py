#!/usr/bin/env python3
"""Writes the small bags in `rosbag1_bags` and `mcap_bags`: pip install rosbags, python make_bags.py"""

import shutil
import tempfile
from pathlib import Path

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

HERE = Path(__file__).parent
STAMPS_NS = [1_000_000_000, 1_100_000_000, 1_200_000_000]
NAME = "std_msgs/msg/String"


def rosbag1(path, compression):
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression:
        writer.set_compression(compression)
    with writer:
        connection = writer.add_connection("/words", NAME, typestore=store)
        for stamp_ns in STAMPS_NS:
            message = store.serialize_ros1(store.types[NAME](data="word"), NAME)
            writer.write(connection, stamp_ns, message)


def mcap(path):
    store = get_typestore(Stores.ROS2_JAZZY)
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "words"
        with Writer2(written, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection("/words", NAME, typestore=store)
            for stamp_ns in STAMPS_NS:
                message = store.serialize_cdr(store.types[NAME](data="word"), NAME)
                writer.write(connection, stamp_ns, message)
        shutil.copy(next(written.glob("*.mcap")), path)


for folder in ["rosbag1_bags", "mcap_bags"]:
    (HERE / folder).mkdir(exist_ok=True)
for name, compression in [
    ("plain", None),
    ("bz2", Writer1.CompressionFormat.BZ2),
    ("lz4", Writer1.CompressionFormat.LZ4),
]:
    path = HERE / "rosbag1_bags" / f"{name}.bag"
    path.unlink(missing_ok=True)
    rosbag1(path, compression)
mcap(HERE / "mcap_bags" / "rosbags.mcap")
