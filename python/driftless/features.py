"""Features of an image. They are those of Driftless itself: its program `driftless` extracts them."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import tempfile
import zlib
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .errors import DriftlessError, Unreadable

PROGRAM_VARIABLE = "DRIFTLESS"
"""Environment variable with the path of the program `driftless`, where it is not on the PATH."""


def extract_features(
    image: str | PathLike[str] | np.ndarray,
    camera: str | PathLike[str],
    *,
    extractor: str | None = None,
    options: tuple[str, ...] = (),
) -> dict[str, Any]:
    """A localization request, as `Fleet.localize` takes it: camera and features of an image.

    Args:
        image: a PNG or JPEG file, or gray levels, shape (height, width), uint8.
        camera: its sensor.yaml (EuRoC), or a camera chain of Kalibr, whose cam0 took it.
        extractor: of the map, as `MapInfo.extractor` names it; the program's default otherwise.
        options: further switches of `driftless extract-features`.
    """
    program = os.environ.get(PROGRAM_VARIABLE) or shutil.which("driftless")
    if program is None:
        raise DriftlessError(
            f"the program `driftless` extracts features: put it on the PATH, or its path into {PROGRAM_VARIABLE}"
        )
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(image, np.ndarray):
            path = Path(folder) / "image.png"
            path.write_bytes(png(image))
        else:
            path = Path(image)
        switches = ["--extractor", extractor] if extractor else []
        command = [program, "extract-features", "--image", path, "--camera", camera, *switches, *options]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError as error:
            raise DriftlessError(f"{program} does not start: {error}") from error
    if done.returncode != 0:
        raise DriftlessError(done.stderr.strip() or f"{program} ended with {done.returncode}")
    request: dict[str, Any] = json.loads(done.stdout)
    return request


def png(gray: np.ndarray) -> bytes:
    """A PNG of gray levels, shape (height, width), uint8."""
    if gray.ndim != 2 or gray.dtype != np.uint8 or 0 in gray.shape:
        raise Unreadable(f"gray levels of type uint8 expected, {gray.dtype} of shape {gray.shape} found")
    height, width = gray.shape
    rows = np.zeros((height, width + 1), np.uint8)  # each row starts with its filter: 0, none
    rows[:, 1:] = gray

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 1))
        + chunk(b"IEND", b"")
    )
