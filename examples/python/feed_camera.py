"""Feeds a robot over Zenoh: images of a camera and readings of an IMU. Needs `pip install eclipse-zenoh`.

    onboard --source native --calibration camchain-imucam.yaml --mode odometry --robot cart7 --listen tcp/0.0.0.0:7447 --out run
    python feed_camera.py --robot cart7 --connect tcp/127.0.0.1:7447 --device 0

Without --device (which needs OpenCV) the images are noise. Put your IMU's driver into read_imu().
"""
import argparse, json, random, threading, time
import zenoh


def read_imu():
    """Angular velocity (rad/s) and specific force (m/s^2, upwards at rest), in the IMU's frame."""
    time.sleep(0.005)
    return [0.0, 0.0, 0.0], [0.0, 0.0, 9.81]


def images(device, width, height):
    if device is None:
        while True:
            time.sleep(0.05)
            yield random.randbytes(width * height), {"encoding": "mono8", "width": width, "height": height}
    import cv2
    camera = cv2.VideoCapture(device)
    while (frame := camera.read())[0]:
        height, width = frame[1].shape[:2]
        yield frame[1].tobytes(), {"encoding": "bgr8", "width": width, "height": height}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="robot")
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
    parser.add_argument("--device", type=int)
    parser.add_argument("--size", default="752x480", help="of images without a device")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    arguments = parser.parse_args()
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([arguments.connect]))
    end = time.monotonic() + arguments.seconds
    with zenoh.open(config) as session:
        topic = f"robot/{arguments.robot}/sensors"

        def feed_imu():
            while time.monotonic() < end:
                gyroscope, accelerometer = read_imu()
                reading = {"stamp_ns": time.time_ns(), "gyroscope": gyroscope, "accelerometer": accelerometer}
                session.put(f"{topic}/imu", json.dumps(reading))

        thread = threading.Thread(target=feed_imu)
        thread.start()
        for image, header in images(arguments.device, *map(int, arguments.size.split("x"))):
            if time.monotonic() >= end:
                break
            session.put(f"{topic}/cam0", image, attachment=json.dumps({"stamp_ns": time.time_ns(), **header}))
        thread.join()


if __name__ == "__main__":
    main()
