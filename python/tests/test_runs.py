"""Recorded runs, against what the program itself says of them."""

import json

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

from driftless import Run, Unreadable
from driftless.plots import plot_errors, plot_track
from driftless.tracks import read_tum


def test_a_run_has_its_states_and_queries(place):
    run = Run(place / "out")
    pose = run.states["global_from_imu"]
    assert len(pose) > 100 and (np.diff(pose.stamps_ns) > 0).all()
    assert np.linalg.eigvalsh(pose.covariances).min() > 0
    tum = read_tum(place / "out" / "pose.tum")
    assert (tum.stamps_ns == pose.stamps_ns).all()
    assert np.allclose(tum.translations, pose.translations, atol=1e-6)
    assert any(row["accepted"] == "true" for row in run.events)


def test_errors_are_those_of_the_program(place):
    run = Run(place / "out")
    errors = run.states["global_from_imu"].errors(run.truth)
    late = errors.stamps_ns >= errors.stamps_ns[0] + 5 * 10**9
    score = run.summary["score"]["pose"]
    rmse = np.sqrt((errors.positions[late] ** 2).sum(axis=1).mean())
    assert rmse == pytest.approx(score["rmse_m"], rel=0.02)
    assert errors.nees[late].mean() == pytest.approx(score["nees_pose"], rel=0.05)


def test_the_truth_is_aligned_with_a_map_whose_frame_is_its_own(place, tmp_path):
    run = Run(place / "out")
    turn = [np.cos(0.4), 0.0, 0.0, np.sin(0.4)]
    (tmp_path / "states.csv").write_text((place / "out" / "states.csv").read_text())
    summary = json.loads((place / "out" / "summary.json").read_text())
    if (place / summary["sequence"]).exists():
        summary["sequence"] = str(place / summary["sequence"])
    summary["score"]["map_from_truth"] = {"rotation_wxyz": turn, "position_m": [1, 2, 3], "gravity_in_map": [0, 0, -1]}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    aligned = Run(tmp_path).truth
    moved = run.truth.moved(turn, [1, 2, 3])
    assert np.allclose(aligned.translations, moved.translations)
    assert np.allclose(moved.translations[:, 2], run.truth.translations[:, 2] + 3)
    states = run.states["global_from_imu"]
    same = states.moved(turn, [1, 2, 3]).errors(aligned)
    assert same.rmse_position == pytest.approx(states.errors(run.truth).rmse_position, rel=1e-6)
    assert same.nees.mean() == pytest.approx(states.errors(run.truth).nees.mean(), rel=1e-6)


def test_a_killed_run_is_read_as_far_as_it_goes(place, tmp_path):
    text = (place / "out" / "states.csv").read_text()
    (tmp_path / "states.csv").write_text(text[: len(text) // 2])
    half = Run(tmp_path)
    whole = Run(place / "out").states["local_from_imu"]
    assert 0.4 < len(half.states["local_from_imu"]) / len(whole) < 0.6
    assert half.summary == {} and half.events == [] and half.truth is None
    with pytest.raises(Unreadable, match="no ground truth"):
        half.states["local_from_imu"].errors(half.truth)


def test_damage_is_named(place, tmp_path):
    with pytest.raises(Unreadable, match="no states.csv"):
        Run(tmp_path)
    lines = (place / "out" / "states.csv").read_text().splitlines()
    lines[5] = lines[5].replace(",", ";", 3)
    (tmp_path / "states.csv").write_text("\n".join(lines))
    with pytest.raises(Unreadable, match="row 5"):
        Run(tmp_path).states


def test_plots_show_the_numbers(place):
    run = Run(place / "out")
    pose = run.states["global_from_imu"]
    line = plot_track(pose).lines[-1]
    assert np.array_equal(line.get_xydata(), pose.translations[:, :2])
    axes = plot_errors(pose.errors(run.truth))
    assert len(axes) == 3 and [text.get_text() for text in axes[0].get_legend().get_texts()] == ["3σ", "error"]
