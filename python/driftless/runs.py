"""The folder of a recorded run, of `driftless run` or `onboard --out`."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

from .errors import Unreadable
from .tracks import Track, read_euroc, read_states


class Run:
    """Results of a run. Files are read when they are first asked for.

    Times are those of the sensors, jumps of their clock included (`summary["clock_shifts"]`). Where that was set back, the
    states and queries of before are in the folder `earlier`, which is a run, too.
    """

    def __init__(self, folder: str | PathLike[str]):
        self.folder: Path = Path(folder)
        if not (self.folder / "states.csv").is_file():
            raise Unreadable(f"{self.folder} is no run: it has no states.csv")

    @cached_property
    def states(self) -> dict[str, Track]:
        """`global_from_imu`, `local_from_imu` and `global_from_local`, those that the run has."""
        return read_states(self.folder / "states.csv")

    @cached_property
    def summary(self) -> dict[str, Any]:
        """summary.json; empty where the run was killed before it was written."""
        path = self.folder / "summary.json"
        if not path.is_file():
            return {}
        try:
            summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise Unreadable(f"{path}: {error}") from error
        return summary

    @cached_property
    def events(self) -> list[dict[str, str]]:
        """One row of events.csv for each query, as text."""
        path = self.folder / "events.csv"
        if not path.is_file():
            return []
        with path.open(encoding="utf-8", newline="") as file:
            rows = csv.DictReader(line.removeprefix("#") for line in file)
            return [row for row in rows if None not in row.values()]

    @cached_property
    def truth(self) -> Track | None:
        """Ground truth of the recording that summary.json names, in the map's frame; `None` where there is none.

        The frame of a map that was built without poses is its own: the truth is then aligned with it in yaw and position, as
        the run was scored (`summary["score"]["map_from_truth"]`). The alignment removes a part of the error, so no NEES of
        the pose in the map is given.

        A relative path is one from here, or from the folder that holds the run.
        """
        sequence = self.summary.get("sequence")
        if sequence is None:
            return None
        for start in (Path(), self.folder.parent):
            for name in ("state_groundtruth_estimate0", "mocap0"):
                path = start / sequence / "mav0" / name / "data.csv"
                if path.is_file():
                    return self._in_map(read_euroc(path))
        return None

    def _in_map(self, truth: Track) -> Track:
        score: Mapping[str, Any] = self.summary.get("score") or {}
        aligned: Mapping[str, Any] | None = score.get("map_from_truth")
        if aligned is None:
            return truth
        return truth.moved(aligned["rotation_wxyz"], aligned["position_m"])
