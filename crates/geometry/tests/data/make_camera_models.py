# Writes camera_models.txt: pip install opencv-contrib-python-headless pycolmap==4.2.1 numpy; python make_camera_models.py
#
# One line "camera SOURCE MODEL COEFFICIENTS..." for each camera, then its points: "x y x' y'", undistorted and distorted normalized
# coordinates, in the region where the radial part of the model increases.
import cv2
import numpy as np
import pycolmap

POINTS = 25
MAX_RADIUS = 3.0
random = np.random.default_rng(7)


def radial(model, k, r):
    """The radial part, for the limit of the region only."""
    if model in ("FULL_OPENCV", "OPENCV"):
        k = list(k) + [0.0] * 12
        s = r * r
        return r * (1 + s * (k[0] + s * (k[1] + s * k[4]))) / (1 + s * (k[5] + s * (k[6] + s * k[7])))
    if model in ("OPENCV_FISHEYE", "THIN_PRISM_FISHEYE"):
        t = np.arctan(r)
        a = k if model == "OPENCV_FISHEYE" else [k[0], k[1], k[4], k[5]]
        return t * (1 + a[0] * t**2 + a[1] * t**4 + a[2] * t**6 + a[3] * t**8)
    return r


def points(model, k):
    r = np.linspace(0.0, MAX_RADIUS, 30_001)
    falls = np.nonzero(np.diff(radial(model, k, r)) <= 0)[0]
    limit = 0.9 * (r[falls[0]] if len(falls) else MAX_RADIUS)
    radius, angle = limit * np.sqrt(random.uniform(0, 1, POINTS)), random.uniform(-np.pi, np.pi, POINTS)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def write(out, source, model, k, xy, distorted):
    out.write(f"camera {source} {model} " + " ".join(repr(float(value)) for value in k) + "\n")
    for pair in np.hstack([xy, distorted]):
        out.write(" ".join(repr(float(value)) for value in pair) + "\n")


def lenses():
    """Coefficients of a webcam, of wide-angle, time-of-flight and fisheye lenses, and random ones around them."""
    full = [
        [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05],
        [0.1147, -0.2327, 0.0007, -0.0003, 0.1094],
        [-0.3542, 0.1679, -0.0011, 0.0004, -0.0421],
        [0.5147, -2.6952, 3.4e-4, -1.2e-4, 1.5303, 0.3918, -2.5122, 1.4587],
        [4.4437, 2.6371, 2.1e-5, 4.1e-5, 0.1350, 4.7707, 3.9256, 0.6871],
        [-0.21, 0.05, 1e-3, -7e-4, -0.004, 0.02, 0.01, 0.003, 1.2e-3, -4e-4, 8e-4, 3e-4],
    ]
    for _ in range(4):
        full.append(list(random.normal(0, [0.2, 0.1, 2e-3, 2e-3, 0.05, 0.1, 0.05, 0.02, 2e-3, 1e-3, 2e-3, 1e-3])))
    return full


FISHEYES = [[0.003482389, 0.000715034, -0.002053236, 0.000202937], [-0.04, 0.02, -0.006, 0.001]]
PRISMS = [
    [-0.0402, 0.0116, 2.1e-4, -3.9e-4, -0.0043, 0.0008, 6.1e-4, -9.3e-4],
    [0.05, -0.03, 1e-3, 2e-3, 0.01, -0.002, -2e-3, 1e-3],
]
OMNIS = [[1.8476, -0.0655, 0.4195, -0.0012, 0.0008], [0.93, -0.2, 0.05, 1e-3, -2e-3]]

with open("camera_models.txt", "w") as out:
    out.write(f"# make_camera_models.py with OpenCV {cv2.__version__} and pycolmap {pycolmap.__version__}\n")
    eye, zero = np.eye(3), np.zeros(3)
    for k in lenses():
        xy = points("FULL_OPENCV", k)
        rays = np.hstack([xy, np.ones((POINTS, 1))])
        write(out, "opencv", "radial-tangential", k, xy, cv2.projectPoints(rays, zero, zero, eye, np.array(k))[0][:, 0])
    for k in FISHEYES:
        xy = points("OPENCV_FISHEYE", k)
        write(out, "opencv", "equidistant", k, xy, cv2.fisheye.distortPoints(xy[:, None], eye, np.array(k))[:, 0])
    for xi, *k in OMNIS:
        xy = points("omni", k)
        xy *= 1.4 / MAX_RADIUS
        rays = np.hstack([xy, np.ones((POINTS, 1))])[:, None]
        projected = cv2.omnidir.projectPoints(rays, zero, zero, eye, xi, np.array(k))[0].reshape(-1, 2)
        write(out, "opencv", "omni", [xi, *k], xy, projected)
    cameras = [("OPENCV", k) for k in lenses() if len(k) == 4]
    cameras += [("FULL_OPENCV", (k + [0.0] * 4)[:8]) for k in lenses()[1:]]
    cameras += [("OPENCV_FISHEYE", k) for k in FISHEYES] + [("FOV", [0.932])] + [("THIN_PRISM_FISHEYE", k) for k in PRISMS]
    for model, k in cameras:
        xy = points(model, k)
        camera = pycolmap.Camera(camera_id=1, model=model, width=2, height=2, params=[1.0, 1.0, 0.0, 0.0, *k])
        rays = np.hstack([xy, np.ones((POINTS, 1))])
        projected = np.array([np.ravel(camera.img_from_cam(ray)) for ray in rays])
        write(out, "colmap", model, k, xy, projected)
