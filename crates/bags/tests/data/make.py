"""Writes an excerpt of a recording in the EuRoC layout in every format that Driftless reads.

    python3 -m venv venv && venv/bin/pip install rosbags pillow
    venv/bin/python make.py MH_01 OUT [--seconds 1.5] [--every 3] [--shrink 8] [--second-camera]

OUT/euroc/                the excerpt in the EuRoC layout, images as PNG
OUT/excerpt.bag           rosbag1, lz4; with bz2 as excerpt_bz2.bag
OUT/excerpt_mcap/         rosbag2 in MCAP, uncompressed, with metadata.yaml
OUT/excerpt_zstd.mcap     the same with zstd chunks
OUT/excerpt_ros1.mcap     MCAP with ROS 1 messages, lz4 chunks
OUT/excerpt_db3/          rosbag2 in SQLite, with metadata.yaml
OUT/excerpt_packed/       the same with each message compressed

A second camera, a mirror image of the first one, is recorded as sensor_msgs/CompressedImage (PNG). Messages are logged later
than their stamps, images more than readings, as on a robot.
"""

import argparse
import csv
import io
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

IMU_LATENCY_NS, IMAGE_LATENCY_NS = 1_000_000, 25_000_000


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=1.5)
    parser.add_argument("--every", type=int, default=3, help="use every Nth image")
    parser.add_argument("--shrink", type=int, default=8, help="size of the images, divided by this")
    parser.add_argument("--second-camera", action="store_true")
    return parser.parse_args()


def rows(path):
    with open(path) as file:
        return [row for row in csv.reader(file) if row and not row[0].startswith("#")]


def sensor_yaml(path):
    text = path.read_text().replace("%YAML:1.0", "").replace("\t", "  ")
    return YAML(typ="safe").load(text)


def read_excerpt(args):
    """Readings, images (stamp, pixels), calibration of the camera, scaled."""
    mav = args.sequence / "mav0"
    images = rows(mav / "cam0/data.csv")
    first = int(images[0][0])
    last = first + int(args.seconds * 1e9)
    used = [row for row in images if int(row[0]) <= last][:: args.every]
    pixels = []
    for stamp, name in used:
        grey = np.asarray(Image.open(mav / "cam0/data" / name).convert("L"))
        size = [side // args.shrink for side in grey.shape]
        cut = grey[: size[0] * args.shrink, : size[1] * args.shrink].astype(float)
        mean = cut.reshape(size[0], args.shrink, size[1], args.shrink).mean(axis=(1, 3))
        pixels.append((int(stamp), np.round(mean).astype(np.uint8)))
    readings = [
        (int(row[0]), [float(cell) for cell in row[1:7]])
        for row in rows(mav / "imu0/data.csv")
        if first - 100_000_000 <= int(row[0]) <= last
    ]
    camera = sensor_yaml(mav / "cam0/sensor.yaml")
    height, width = pixels[0][1].shape
    fu, fv, cu, cv = camera["intrinsics"]
    centre = lambda c: (c + 0.5) / args.shrink - 0.5
    camera["intrinsics"] = [fu / args.shrink, fv / args.shrink, centre(cu), centre(cv)]
    camera["resolution"] = [width, height]
    camera["rate_hz"] = camera["rate_hz"] / args.every
    return readings, pixels, camera


def png(pixels):
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG", optimize=True)
    return out.getvalue()


def write_euroc(args, out, readings, cameras, camera):
    mav = out / "mav0"
    (mav / "imu0").mkdir(parents=True)
    shutil.copy(args.sequence / "mav0/imu0/sensor.yaml", mav / "imu0")
    with open(mav / "imu0/data.csv", "w") as file:
        file.write("#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z\n")
        for stamp, cells in readings:
            file.write(",".join([str(stamp), *map(repr, cells)]) + "\n")
    for index, images in enumerate(cameras):
        folder = mav / f"cam{index}"
        (folder / "data").mkdir(parents=True)
        matrix = ", ".join(map(repr, map(float, camera["T_BS"]["data"])))
        (folder / "sensor.yaml").write_text(
            f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{matrix}]\n"
            f"rate_hz: {camera['rate_hz']}\nresolution: {camera['resolution']}\ncamera_model: pinhole\n"
            f"intrinsics: {camera['intrinsics']}\ndistortion_model: radial-tangential\n"
            f"distortion_coefficients: {camera['distortion_coefficients']}\n"
        )
        with open(folder / "data.csv", "w") as file:
            file.write("#timestamp [ns],filename\n")
            for stamp, pixels in images:
                file.write(f"{stamp},{stamp}.png\n")
                (folder / "data" / f"{stamp}.png").write_bytes(png(pixels))


class Messages:
    """The messages of an excerpt, in the types of one version of ROS."""

    def __init__(self, store, ros1):
        self.store, self.ros1 = store, ros1
        self.types = store.types

    def header(self, stamp, frame):
        time = self.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        sequence = {"seq": 0} if self.ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **sequence)

    def imu(self, stamp, cells):
        vector = lambda values: self.types["geometry_msgs/msg/Vector3"](x=values[0], y=values[1], z=values[2])
        return self.types["sensor_msgs/msg/Imu"](
            header=self.header(stamp, "imu0"),
            orientation=self.types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.array([-1.0] + [0.0] * 8),
            angular_velocity=vector(cells[:3]),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(cells[3:]),
            linear_acceleration_covariance=np.zeros(9),
        )

    def image(self, stamp, pixels):
        height, width = pixels.shape
        return self.types["sensor_msgs/msg/Image"](
            header=self.header(stamp, "cam0"),
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=pixels.reshape(-1),
        )

    def compressed(self, stamp, pixels):
        return self.types["sensor_msgs/msg/CompressedImage"](
            header=self.header(stamp, "cam1"), format="mono8; png compressed", data=np.frombuffer(png(pixels), np.uint8)
        )

    def camera_info(self, stamp, camera, frame):
        fu, fv, cu, cv = camera["intrinsics"]
        d = np.array([*camera["distortion_coefficients"], 0.0])
        k = np.array([fu, 0, cu, 0, fv, cv, 0, 0, 1], float)
        r = np.eye(3).reshape(-1)
        p = np.array([fu, 0, cu, 0, 0, fv, cv, 0, 0, 0, 1, 0], float)
        matrices = {"D": d, "K": k, "R": r, "P": p} if self.ros1 else {"d": d, "k": k, "r": r, "p": p}
        return self.types["sensor_msgs/msg/CameraInfo"](
            header=self.header(stamp, frame),
            height=camera["resolution"][1],
            width=camera["resolution"][0],
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=self.types["sensor_msgs/msg/RegionOfInterest"](
                x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
            ),
            **matrices,
        )

    def all(self, readings, cameras, camera):
        """Log time, topic, type and message, in order of log time."""
        found = [(s + IMU_LATENCY_NS, "/imu0", "sensor_msgs/msg/Imu", self.imu(s, c)) for s, c in readings]
        text = self.types["std_msgs/msg/String"](data="hello")
        found.append((readings[0][0], "/chatter", "std_msgs/msg/String", text))
        for index, images in enumerate(cameras):
            for stamp, pixels in images:
                log = stamp + IMAGE_LATENCY_NS
                info = self.camera_info(stamp, camera, f"cam{index}")
                found.append((log, f"/cam{index}/camera_info", "sensor_msgs/msg/CameraInfo", info))
                if index == 0:
                    found.append((log, "/cam0/image_raw", "sensor_msgs/msg/Image", self.image(stamp, pixels)))
                else:
                    message = self.compressed(stamp, pixels)
                    found.append((log, "/cam1/image_raw/compressed", "sensor_msgs/msg/CompressedImage", message))
        return sorted(found, key=lambda row: row[0])

    def serialize(self, message, kind):
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        return bytes(serialize(message, kind))


def write(writer, messages, found):
    connections = {}
    with writer:
        for log, topic, kind, message in found:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(connections[topic], log, messages.serialize(message, kind))


def write_ros1_mcap(path, messages, found):
    """By hand with the official library, since rosbags does not write ROS 1 messages into MCAP."""
    from mcap.writer import CompressionType
    from mcap.writer import Writer as McapWriter

    with open(path, "wb") as file:
        writer = McapWriter(file, chunk_size=100_000, compression=CompressionType.LZ4)
        writer.start(profile="ros1")
        channels = {}
        for log, topic, kind, message in found:
            if topic not in channels:
                definition, _ = messages.store.generate_msgdef(kind)
                name = kind.replace("/msg/", "/")
                schema = writer.register_schema(name, "ros1msg", definition.encode())
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            writer.add_message(channels[topic], log, messages.serialize(message, kind), log)
        writer.finish()


def main():
    args = arguments()
    readings, pixels, camera = read_excerpt(args)
    cameras = [pixels]
    if args.second_camera:
        cameras.append([(stamp, np.ascontiguousarray(image[:, ::-1])) for stamp, image in pixels])
    args.out.mkdir(parents=True, exist_ok=True)
    write_euroc(args, args.out / "euroc", readings, cameras, camera)
    one = Messages(get_typestore(Stores.ROS1_NOETIC), ros1=True)
    two = Messages(get_typestore(Stores.ROS2_JAZZY), ros1=False)
    found_one, found_two = (m.all(readings, cameras, camera) for m in (one, two))

    for name, packing in [("excerpt", "LZ4"), ("excerpt_bz2", "BZ2")]:
        writer = Writer1(args.out / f"{name}.bag")
        writer.set_compression(getattr(Writer1.CompressionFormat, packing))
        writer.chunk_threshold = 60_000
        write(writer, one, found_one)
    write_ros1_mcap(args.out / "excerpt_ros1.mcap", one, found_one)
    for name, plugin, packing in [
        ("excerpt_mcap", StoragePlugin.MCAP, None),
        ("excerpt_zstd", StoragePlugin.MCAP, CompressionMode.STORAGE),
        ("excerpt_db3", StoragePlugin.SQLITE3, None),
        ("excerpt_packed", StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    ]:
        writer = Writer2(args.out / name, version=9, storage_plugin=plugin)
        if packing:
            writer.set_compression(packing, CompressionFormat.ZSTD)
        write(writer, two, found_two)
    (args.out / "excerpt_zstd/excerpt_zstd.mcap").rename(args.out / "excerpt_zstd.mcap")
    shutil.rmtree(args.out / "excerpt_zstd")


if __name__ == "__main__":
    main()
