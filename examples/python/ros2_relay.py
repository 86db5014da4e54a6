"""Brings the topics that `onboard --ros2` and `driftless ros2-map` publish to ROS 2 of any distribution and middleware: Humble, DDS.

Needs a sourced ROS 2 and `pip install eclipse-zenoh`. It takes the place of `rmw_zenohd`:

    python ros2_relay.py --listen tcp/127.0.0.1:7447
    onboard --sequence place/live --map place --connect tcp/192.168.1.2:7447 --realtime --out out --ros2

Messages are passed on as they are: the bytes of a message are the same with every middleware.
"""
import argparse, importlib, json, time
import rclpy, zenoh
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# Topics, their types, and whether who comes later gets the last message.
TOPICS = [
    ("/odometry", "nav_msgs/msg/Odometry", False),
    ("/odometry_predicted", "nav_msgs/msg/Odometry", False),
    ("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", False),
    ("/path", "nav_msgs/msg/Path", True),
    ("/tf", "tf2_msgs/msg/TFMessage", False),
    ("/tf_static", "tf2_msgs/msg/TFMessage", True),
    ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", False),
    ("/clock", "rosgraph_msgs/msg/Clock", False),
    ("/map", "nav_msgs/msg/OccupancyGrid", True),
    ("/map_points", "sensor_msgs/msg/PointCloud2", True),
]


def relay(session, node, domain, namespace, topic, name, is_latched):
    """Passes on what is published of a topic; returns the subscriber."""
    package, _, short = name.split("/")
    kind = getattr(importlib.import_module(f"{package}.msg"), short)
    is_global = topic in ("/tf", "/tf_static", "/diagnostics", "/clock")
    topic = topic if is_global or not namespace else f"/{namespace.strip('/')}{topic}"
    durability = DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
    qos = QoSProfile(depth=1 if is_latched else 100, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
    publisher = node.create_publisher(kind, topic, qos)
    # Any version of the type, whose hash is at the end.
    key = f"{domain}/{topic.strip('/')}/{package}::msg::dds_::{short}_/*"
    return session.declare_subscriber(key, lambda sample: publisher.publish(sample.payload.to_bytes()))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--listen", default="tcp/127.0.0.1:7447", help="where --ros2-connect connects to")
    parser.add_argument("--domain", type=int, default=0, help="as --ros2-domain")
    parser.add_argument("--namespace", default="", help="as --ros2-namespace")
    arguments = parser.parse_args()
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([arguments.listen]))
    config.insert_json5("scouting/multicast/enabled", "false")
    rclpy.init()
    node = rclpy.create_node("driftless_relay")
    with zenoh.open(config) as session:
        subscribers = []
        for topic, name, is_latched in TOPICS:
            try:
                subscribers.append(
                    relay(session, node, arguments.domain, arguments.namespace, topic, name, is_latched)
                )
            except ImportError as error:
                print(f"{topic} is not relayed: {error}", flush=True)
        print(f"{len(subscribers)} topics, from {arguments.listen}", flush=True)
        try:
            while rclpy.ok():
                time.sleep(0.2)
        except KeyboardInterrupt:
            pass


if __name__ == "__main__":
    main()
