"""Runs odometry of Driftless as a baseline of VSLAM-LAB, with the arguments that it gives to a baseline.

    python vslam_lab.py --sequence_path SEQUENCE --calibration_yaml SEQUENCE/calibration.yaml \\
        --rgb_csv SEQUENCE/rgb.csv --exp_folder OUT --exp_it 0 --mode stereo-vi

Needs `driftless` on the PATH (or in $DRIFTLESS), and `pip install numpy pyyaml`. Reads images, readings of the IMU and calibration in the
form of VSLAM-LAB, and writes OUT/00000_KeyFrameTrajectory.csv: the pose of the left camera at every image. The recording is in
OUT/00000_driftless in the EuRoC layout, with links to the images, and beside it all that `driftless run` writes.
"""
import argparse, csv, os, subprocess
from pathlib import Path

import numpy as np
import yaml

# VSLAM-LAB's names of distortions, and those of EuRoC's sensor.yaml.
DISTORTIONS = {"radtan": "radial-tangential", "equid": "equidistant"}


def sensor_yaml(kind, entries, imu_from_sensor):
    """The sensor.yaml of a sensor."""
    lines = [f"sensor_type: {kind}", "T_BS:", "  cols: 4", "  rows: 4"]
    lines += [f"  data: [{', '.join(repr(float(number)) for number in imu_from_sensor.ravel())}]"]
    return "\n".join(lines + [f"{name}: {value}" for name, value in entries.items()]) + "\n"


def transform(entry):
    return np.array(entry.get("T_BS", np.eye(4)), float).reshape(4, 4)


def camera_entries(camera):
    """A camera of calibration.yaml as entries of sensor.yaml."""
    coefficients = [float(number) for number in camera.get("distortion_coefficients") or []]
    # Older files name the distortion in cam_model.
    name = camera.get("distortion_type") or camera["cam_model"]
    model = next((theirs for ours, theirs in DISTORTIONS.items() if name.startswith(ours)), "none")
    return {
        "camera_model": "pinhole",
        "rate_hz": camera.get("fps", 20),
        "resolution": list(camera["image_dimension"]),
        "intrinsics": [float(number) for number in [*camera["focal_length"], *camera["principal_point"]]],
        "distortion_model": model,
        "distortion_coefficients": coefficients if model != "none" else [],
    }


def write_recording(folder, args, cameras, imu):
    """The recording in the EuRoC layout; the first camera is cam0."""
    mav = folder / "mav0"
    with open(args.rgb_csv, newline="") as file:
        rows = list(csv.DictReader(file))
    for index, camera in enumerate(cameras):
        data = mav / f"cam{index}" / "data"
        data.mkdir(parents=True)
        (data.parent / "sensor.yaml").write_text(sensor_yaml("camera", camera_entries(camera), transform(camera)))
        name = camera["cam_name"]
        with open(data.parent / "data.csv", "w") as table:
            table.write("#timestamp [ns],filename\n")
            for row in rows:
                image = (args.sequence_path / row[f"path_{name}"]).resolve()
                link = data / f"{row[f'ts_{name} (ns)']}{image.suffix}"
                link.symlink_to(image)
                table.write(f"{link.stem},{link.name}\n")
    (mav / "imu0").mkdir()
    noise = {
        "rate_hz": imu.get("fps", 200),
        "gyroscope_noise_density": imu["sigma_g_c"],
        "gyroscope_random_walk": imu["sigma_gw_c"],
        "accelerometer_noise_density": imu["sigma_a_c"],
        "accelerometer_random_walk": imu["sigma_aw_c"],
    }
    (mav / "imu0" / "sensor.yaml").write_text(sensor_yaml("imu", noise, transform(imu)))
    readings = (args.sequence_path / f"{imu['imu_name']}.csv").read_text().splitlines()[1:]
    (mav / "imu0" / "data.csv").write_text("\n".join(["#timestamp [ns],w x y z,a x y z", *readings]) + "\n")


def quaternion(rotation):
    """The unit quaternion (x, y, z, w) of a rotation matrix: an eigenvector (Bar-Itzhack 2000)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    symmetric = [[a - e - i, b + d, c + g, h - f], [b + d, e - a - i, f + h, c - g],
                 [c + g, f + h, i - a - e, d - b], [h - f, c - g, d - b, a + e + i]]
    return np.linalg.eigh(np.array(symmetric))[1][:, 3]


def product(p, q):
    """The product of two quaternions (x, y, z, w)."""
    vector = p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3])
    return np.array([*vector, p[3] * q[3] - p[:3] @ q[:3]])


def write_trajectory(odometry, imu_from_camera, path):
    """Poses of the IMU in a TUM file as those of the camera, in the table of VSLAM-LAB."""
    rotation, translation = quaternion(imu_from_camera[:3, :3]), imu_from_camera[:3, 3]
    with open(odometry) as poses, open(path, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["ts (ns)", "tx (m)", "ty (m)", "tz (m)", "qx", "qy", "qz", "qw"])
        for line in poses:
            if line.startswith("#"):
                continue
            seconds, *numbers = line.split()
            whole, fraction = seconds.split(".")
            pose = np.array(numbers, float)
            # A point of the camera, turned by q p q*.
            turned = product(product(pose[3:], np.array([*translation, 0.0])), pose[3:] * [-1, -1, -1, 1])[:3]
            table.writerow([whole + fraction, *(pose[:3] + turned), *product(pose[3:], rotation)])


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("sequence_path", "calibration_yaml", "rgb_csv", "exp_folder"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--exp_it", type=int, default=0)
    parser.add_argument("--mode", choices=["mono-vi", "stereo-vi"], default="mono-vi")
    # Others that VSLAM-LAB gives to every baseline are not needed.
    args, _ = parser.parse_known_args(arguments)

    calibration = yaml.safe_load(args.calibration_yaml.read_text())
    cameras = calibration["cameras"][: 2 if args.mode == "stereo-vi" else 1]
    folder = args.exp_folder / f"{args.exp_it:05}_driftless"
    write_recording(folder, args, cameras, calibration["imus"][0])
    program = os.environ.get("DRIFTLESS", "driftless")
    out = folder / "out"
    subprocess.run([program, "run", folder, "--mode", "odometry", "--out", out], check=True, stdout=subprocess.DEVNULL)

    poses = args.exp_folder / f"{args.exp_it:05}_KeyFrameTrajectory.csv"
    write_trajectory(out / "odometry.tum", transform(cameras[0]), poses)


if __name__ == "__main__":
    main()
