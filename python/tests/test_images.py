"""An image file is localized, in the five lines of the README."""

import subprocess

import numpy as np
import pytest

from driftless import DriftlessError, extract_features
from driftless.features import png
from driftless.tracks import read_euroc


def camera_yaml(folder, width, height):
    path = folder / "sensor.yaml"
    path.write_text(
        f"sensor_type: camera\ncamera_model: pinhole\nresolution: [{width}, {height}]\n"
        "intrinsics: [100.0, 100.0, 80.0, 60.0]\ndistortion_model: none\ndistortion_coefficients: []\n"
    )
    return path


def blobs(width, height):
    """A smooth picture with corners to find."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 255, (height // 10, width // 10), dtype=np.uint8)
    return np.repeat(np.repeat(coarse, 10, axis=0), 10, axis=1)


def test_an_image_is_localized_in_five_lines(room, room_endpoint):
    sensor = room / "room" / "live" / "mav0" / "cam0"
    image = sorted((sensor / "data").glob("*.png"))[len(list((sensor / "data").glob("*.png"))) // 2]
    truth = read_euroc(room / "room" / "live" / "mav0" / "state_groundtruth_estimate0" / "data.csv")

    from driftless import Fleet

    with Fleet(room_endpoint) as fleet:
        found = fleet.localize("room", image, sensor / "sensor.yaml")
        print(found.outcome, found.global_from_camera)

    assert found.outcome == "matched" and found.inliers > 30
    inside, body = truth.at(np.array([int(image.stem)]))
    assert inside.all()
    distance = np.linalg.norm(found.global_from_camera.translation - body.translations[0])
    assert distance < 0.15  # the camera is 0.07 m from the IMU


def test_an_array_has_the_features_of_its_file(program, tmp_path):
    image, camera = blobs(160, 120), camera_yaml(tmp_path, 160, 120)
    (tmp_path / "image.png").write_bytes(png(image))
    of_array = extract_features(image, camera)
    assert of_array == extract_features(tmp_path / "image.png", camera)
    assert len(of_array["features"]["pixels"]) > 10 and of_array["camera"]["width"] == 160
    few = extract_features(image, camera, options=("--max-features", "5"))
    assert len(few["features"]["pixels"]) <= 5


def test_what_the_program_refuses_is_said(program, tmp_path):
    camera = camera_yaml(tmp_path, 160, 120)
    with pytest.raises(DriftlessError, match="100 x 80 pixels"):
        extract_features(np.zeros((80, 100), np.uint8), camera)
    with pytest.raises(DriftlessError, match="missing.png"):
        extract_features("missing.png", camera)
    with pytest.raises(DriftlessError, match="uint8"):
        extract_features(np.zeros((80, 100)), camera)
