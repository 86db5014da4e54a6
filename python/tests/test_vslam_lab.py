"""Driftless as a baseline of VSLAM-LAB."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import yaml

from driftless.poses import rotation_matrices
from driftless.tracks import read_tum

ADAPTER = Path(__file__).resolve().parents[2] / "examples" / "python" / "vslam_lab.py"


def vslam_lab_sequence(recording, sequence):
    """A recording in the EuRoC layout in that of VSLAM-LAB."""
    sequence.mkdir()
    mav, cameras, stamps = recording / "mav0", [], []
    for index in range(2):
        folder = mav / f"cam{index}"
        sensor = yaml.safe_load((folder / "sensor.yaml").read_text())
        assert sensor["distortion_model"] == "radial-tangential"
        cameras.append(
            {
                "cam_name": f"rgb_{index}",
                "cam_type": "gray",
                "cam_model": "pinhole",
                "distortion_type": "radtan4",
                "focal_length": sensor["intrinsics"][:2],
                "principal_point": sensor["intrinsics"][2:],
                "distortion_coefficients": sensor["distortion_coefficients"],
                "image_dimension": sensor["resolution"],
                "fps": sensor["rate_hz"],
                "T_BS": sensor["T_BS"]["data"],
            }
        )
        (sequence / f"rgb_{index}").symlink_to(folder / "data")
        stamps.append([line.split(",")[0] for line in (folder / "data.csv").read_text().splitlines()[1:]])
    imu = yaml.safe_load((mav / "imu0" / "sensor.yaml").read_text())
    imus = [
        {
            "imu_name": "imu_0",
            "sigma_g_c": imu["gyroscope_noise_density"],
            "sigma_gw_c": imu["gyroscope_random_walk"],
            "sigma_a_c": imu["accelerometer_noise_density"],
            "sigma_aw_c": imu["accelerometer_random_walk"],
            "fps": imu["rate_hz"],
            "T_BS": np.eye(4).ravel().tolist(),
        }
    ]
    (sequence / "calibration.yaml").write_text(yaml.safe_dump({"cameras": cameras, "imus": imus}))
    readings = (mav / "imu0" / "data.csv").read_text().splitlines()[1:]
    header = "ts (ns),wx (rad s^-1),wy (rad s^-1),wz (rad s^-1),ax (m s^-2),ay (m s^-2),az (m s^-2)"
    (sequence / "imu_0.csv").write_text("\n".join([header, *readings]) + "\n")
    rows = [f"{a},rgb_0/{a}.png,{b},rgb_1/{b}.png" for a, b in zip(*stamps)]
    (sequence / "rgb.csv").write_text("\n".join(["ts_rgb_0 (ns),path_rgb_0,ts_rgb_1 (ns),path_rgb_1", *rows]) + "\n")
    return np.array(cameras[0]["T_BS"]).reshape(4, 4)


def test_the_trajectory_is_that_of_the_left_camera(program, room, tmp_path):
    recording = room / "room" / "map"
    imu_from_camera = vslam_lab_sequence(recording, tmp_path / "sequence")
    files = [f"--{name}={tmp_path / 'sequence' / file}" for name, file in
             [("sequence_path", ""), ("calibration_yaml", "calibration.yaml"), ("rgb_csv", "rgb.csv")]]
    adapter = [sys.executable, str(ADAPTER), *files, f"--exp_folder={tmp_path}", "--exp_it=7", "--mode=stereo-vi"]
    done = subprocess.run([*adapter, "--settings_yaml=none"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    run = [program("driftless"), "run", str(recording), "--mode", "odometry", "--out", str(tmp_path / "own")]
    assert subprocess.run(run, capture_output=True).returncode == 0

    odometry = read_tum(tmp_path / "own" / "odometry.tum")
    with open(tmp_path / "00007_KeyFrameTrajectory.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["ts (ns)"]) for row in rows] == odometry.stamps_ns.tolist() and len(rows) > 20
    for row, local_from_imu in zip(rows, odometry):
        position = np.array([float(row[f"t{axis} (m)"]) for axis in "xyz"])
        rotation = rotation_matrices(np.array([float(row[f"q{axis}"]) for axis in "wxyz"]))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = local_from_imu.rotation, local_from_imu.translation
        camera = matrix @ imu_from_camera
        assert np.allclose(position, camera[:3, 3], atol=1e-8) and np.allclose(rotation, camera[:3, :3], atol=1e-8)
