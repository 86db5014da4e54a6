"""Plots with matplotlib (`pip install driftless[plot]`)."""
# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave out the types of keyword arguments.

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from .messages import Keyframe
from .poses import Array
from .tracks import Errors, Track

# Colours that are told apart with colour-blindness (Okabe and Ito).
BLUE, ORANGE, GREY = "#0072b2", "#e69f00", "#777777"


def plot_map(keyframes: list[Keyframe], ax: Axes | None = None) -> Axes:
    """A map from above: keyframes, with ellipses of three standard deviations."""
    ax = ax or plt.gca()
    poses = [keyframe.global_from_keyframe for keyframe in keyframes]
    positions = np.array([pose.translation for pose in poses]).reshape(-1, 3)
    ax.plot(positions[:, 0], positions[:, 1], "o", color=GREY, markersize=3, label="keyframes")
    for pose in poses:
        if pose.covariance is not None:
            outline = ellipse(pose.translation[:2], pose.covariance[3:5, 3:5])
            ax.plot(outline[:, 0], outline[:, 1], color=GREY, linewidth=0.8)
    return _from_above(ax)


def plot_track(track: Track, ax: Axes | None = None, label: str = "estimate", color: str = BLUE) -> Axes:
    """A trajectory from above."""
    ax = ax or plt.gca()
    ax.plot(track.translations[:, 0], track.translations[:, 1], color=color, linewidth=1.2, label=label)
    return _from_above(ax)


def plot_errors(errors: Errors, axes: list[Axes] | None = None) -> list[Axes]:
    """Errors of the position over time, each axis with its bound of three standard deviations."""
    if axes is None:
        axes = list(plt.subplots(3, 1, sharex=True, layout="constrained")[1])
    seconds = (errors.stamps_ns - errors.stamps_ns[0]) * 1e-9
    for index, ax in enumerate(axes):
        if errors.covariances is not None:
            bound = 3 * np.sqrt(errors.covariances[:, 3 + index, 3 + index])
            ax.fill_between(seconds, -bound, bound, color=ORANGE, alpha=0.3, linewidth=0, label="3σ")
        ax.plot(seconds, errors.positions[:, index], color=BLUE, linewidth=1, label="error")
        ax.set_ylabel(f"{'xyz'[index]} (m)")
    axes[0].legend(loc="upper right")
    axes[-1].set_xlabel("time (s)")
    return axes


def ellipse(centre: Array, covariance: Array, sigmas: float = 3.0, points: int = 60) -> Array:
    """Outline of the ellipse of some standard deviations, shape (points, 2)."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, points)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    outline: Array = centre + sigmas * (vectors * np.sqrt(np.maximum(values, 0)) @ circle).T
    return outline


def _from_above(ax: Axes) -> Axes:
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    return ax
