# Writes this model: pip install pycolmap==4.2.1 numpy; python make.py
import numpy as np
import pycolmap

LENSES = {
    1: ("FULL_OPENCV", [458.0, 457.0, 320.5, 240.5, 0.51, -2.69, 3e-4, -1e-4, 1.53, 0.39, -2.51, 1.46]),
    2: ("THIN_PRISM_FISHEYE", [301.0, 300.0, 321.5, 239.5, -0.04, 0.0116, 2.1e-4, -3.9e-4, -0.0043, 8e-4, 6.1e-4, -9.3e-4]),
    3: ("FULL_OPENCV", [458.0, 457.0, 320.5, 240.5, 0.11, -0.23, 7e-4, -3e-4, 0.11, 0.0, 0.0, 0.0]),
    4: ("FULL_OPENCV", [458.0, 457.0, 320.5, 240.5, 0.11, -0.23, 7e-4, -3e-4, 0.0, 0.0, 0.0, 0.0]),
}
model = pycolmap.Reconstruction()
for camera, (name, parameters) in LENSES.items():
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=camera, model=name, width=640, height=480, params=parameters)
    )
points = [np.array([0.4 * i - 0.6, 0.3 - 0.2 * i, 2.0 + 0.3 * i]) for i in range(4)]
ids = [model.add_point3D(point, pycolmap.Track(), np.array([1, 2, 3], np.uint8)) for point in points]
for camera in LENSES:
    turn = np.array([0.01 * camera, 0.02, -0.03 * camera, 1.0])
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn / np.linalg.norm(turn)), np.array([0.1 * camera, -0.2, 0.05]))
    image = pycolmap.Image(image_id=camera, name=f"cam{camera}/1000000000.png", camera_id=camera)
    pixels = [np.ravel(model.cameras[camera].img_from_cam(pose * point)) for point in points]
    image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixel) for pixel in pixels])
    model.add_image_with_trivial_frame(image, pose)
    for index, point in enumerate(ids):
        model.add_observation(point, pycolmap.TrackElement(camera, index))
model.update_point_3d_errors()
model.write_text(".")
model.write_binary(".")
