"""Writes factors.json: preintegrated IMU factors of GTSAM, for the test `gtsam`.

    pip install gtsam numpy && python make.py
"""

import json
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

GRAVITY = 9.80665
# White noise and bias random walk: rad/s/sqrt(Hz), m/s^2/sqrt(Hz), rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz).
NOISE = {"gyroscope": 2e-3, "accelerometer": 2e-2, "gyroscope_walk": 3e-4, "accelerometer_walk": 4e-3}
# GTSAM integrates the rotation vector by Euler steps: they must be short.
RATE_HZ = 200_000


def reading(t):
    """Angular velocity and specific force at a time; the test has the same."""
    gyroscope = [0.1 + 0.3 * np.sin(2.0 * t), -0.4 * np.cos(3.0 * t), 0.5 + 0.2 * np.sin(t)]
    accelerometer = [1.2 * np.cos(2.5 * t), 0.7 * np.sin(1.7 * t) - 0.3, 9.6 + 0.8 * np.sin(4.0 * t)]
    return np.array(gyroscope), np.array(accelerometer)


def parameters():
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(GRAVITY)
    parameters.setGyroscopeCovariance(np.eye(3) * NOISE["gyroscope"] ** 2)
    parameters.setAccelerometerCovariance(np.eye(3) * NOISE["accelerometer"] ** 2)
    parameters.setBiasOmegaCovariance(np.eye(3) * NOISE["gyroscope_walk"] ** 2)
    parameters.setBiasAccCovariance(np.eye(3) * NOISE["accelerometer_walk"] ** 2)
    parameters.setIntegrationCovariance(np.zeros((3, 3)))
    return parameters


def as_json(state, bias):
    q = state.attitude().toQuaternion()
    return {
        "quaternion_wxyz": [q.w(), q.x(), q.y(), q.z()],
        "position": list(state.position()),
        "velocity": list(state.velocity()),
        "gyroscope_bias": list(bias.gyroscope()),
        "accelerometer_bias": list(bias.accelerometer()),
    }


def factor(seconds, random):
    at = gtsam.imuBias.ConstantBias(random.normal(0, 0.05, 3), random.normal(0, 0.02, 3))
    integrated = gtsam.PreintegratedCombinedMeasurements(parameters(), at)
    for k in range(round(seconds * RATE_HZ)):
        gyroscope, accelerometer = reading((k + 0.5) / RATE_HZ)
        # GTSAM takes the specific force to be in the frame of the begin of the step: an error of first order.
        turned = gtsam.Rot3.Expmap((gyroscope - at.gyroscope()) * 0.5 / RATE_HZ)
        accelerometer = turned.rotate(accelerometer - at.accelerometer()) + at.accelerometer()
        integrated.integrateMeasurement(accelerometer, gyroscope, 1.0 / RATE_HZ)

    attitude = gtsam.Rot3.RzRyRx(*random.uniform(-1, 1, 3))
    begin = gtsam.NavState(attitude, gtsam.Point3(random.normal(0, 5, 3)), random.normal(0, 2, 3))
    shift = random.normal(0, 1, 6) * np.repeat([1e-3, 1e-4], 3)
    bias = gtsam.imuBias.ConstantBias(at.accelerometer() + shift[:3], at.gyroscope() + shift[3:])
    predicted = integrated.predict(begin, bias)

    deviation = np.sqrt(np.diag(integrated.preintMeasCov()))
    moved = predicted.retract(random.normal(0, 1, 9) * deviation[:9])
    walked = bias.retract(random.normal(0, 1, 6) * deviation[9:])
    values = gtsam.Values()
    for key, pose in [(X(0), begin.pose()), (X(1), moved.pose())]:
        values.insert(key, pose)
    for key, velocity in [(V(0), begin.velocity()), (V(1), moved.velocity())]:
        values.insert(key, velocity)
    values.insert(B(0), bias)
    values.insert(B(1), walked)
    error = gtsam.CombinedImuFactor(X(0), V(0), X(1), V(1), B(0), B(1), integrated).error(values)
    return {
        "seconds": seconds,
        "integrated_at": {"gyroscope": list(at.gyroscope()), "accelerometer": list(at.accelerometer())},
        "begin": as_json(begin, bias),
        "predicted": as_json(predicted, bias),
        "end": as_json(moved, walked),
        "chi_square": 2.0 * error,
    }


def main():
    random = np.random.default_rng(1)
    factors = [factor(seconds, random) for seconds in (0.05, 0.1, 0.25, 0.5, 0.5, 1.0, 1.0, 2.0)]
    text = json.dumps({"gravity": GRAVITY, "noise": NOISE, "factors": factors}, indent=1)
    Path(__file__).with_name("factors.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
