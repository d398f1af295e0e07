"""Options of `jaxcap limits learn`: what is left out, margins, people, both sides, and conventions of tables."""

import numpy as np
import pytest
from command_line import fails, runs
from limits_legs import HUMAN, leg_motion

import jaxcap as jc


@pytest.fixture(scope="module")
def takes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("options")
    paths = [folder / f"take{seed}.npz" for seed in range(3)]
    for seed, path in enumerate(paths):
        jc.save_motion(path, leg_motion(seed, 400), HUMAN)
    return paths


def learn(capsys, takes, tmp_path, *options) -> tuple[str, dict[str, list[str]]]:
    """Learn limits; return the last sentence before the path, and the rows of the table by joint."""
    out = tmp_path / "limits.npz"
    lines = runs(capsys, "limits", "learn", *takes, "-o", out, "--overwrite", *options).splitlines()
    rows = {line.split()[0]: line.split() for line in lines if line.split()}
    return next(line for line in reversed(lines) if not line.startswith("written")), rows


def margins(rows, *joints) -> list[float]:
    return [float(rows[joint][-2].rstrip("°")) for joint in joints]


def test_what_is_left_out_is_said(capsys, takes, tmp_path):
    knee = ("--joints", "LeftLeg")
    said, _ = learn(capsys, takes, tmp_path, *knee)
    assert (
        said == "margins are chosen by leaving out each of 3 takes, of which the others allow 99 % on average"
    )
    said, _ = learn(capsys, takes, tmp_path, *knee, "--people", "anna,ben,anna", "--coverage", 0.9)
    assert (
        said
        == "margins are chosen by leaving out each of 2 people, of which the others allow 90 % on average"
    )
    said, _ = learn(capsys, takes, tmp_path, *knee, "--people", "anna,ben,anna", "--hold-out", "takes")
    assert "each of 3 takes" in said
    said, rows = learn(capsys, takes, tmp_path, *knee, "--hold-out", "blocks")
    assert said.startswith(
        "widths of voxels are chosen by leaving out blocks of ten seconds, of which the others allow 98 %"
    )
    assert not said.endswith("give several takes") and margins(rows, "LeftLeg") == [0.0]
    said, _ = learn(capsys, takes[:1], tmp_path, *knee)
    assert said.endswith("give several takes")
    told = fails(capsys, "limits", "learn", takes[0], "-o", tmp_path / "x.npz", *knee, "--hold-out", "takes")
    assert "The samples are of 1 takes, so none can be left out" in told
    told = fails(capsys, "limits", "learn", *takes, "-o", tmp_path / "x.npz", *knee, "--people", "anna,ben")
    assert "--people has 2 names for 3 files" in told


def test_given_sizes_are_not_said_to_be_chosen(capsys, takes, tmp_path):
    pair = ("--joints", "LeftUpLeg:LeftLeg")
    none = "all sizes are those given; no motion was left out to choose them"
    assert learn(capsys, takes, tmp_path, "--joints", "LeftLeg", "--margin", 5)[0] == none
    assert learn(capsys, takes, tmp_path, "--joints", "LeftLeg", "--voxel", 5)[0] == none
    said, rows = learn(capsys, takes, tmp_path, *pair, "--voxel", 20, "--keyframe-width", 40, "--margin", 6)
    assert said == none and margins(rows, "LeftUpLeg", "LeftLeg") == [6.0, 6.0]
    said, _ = learn(capsys, takes, tmp_path, *pair, "--voxel", 20)
    assert said.startswith(
        "widths of keyframes are chosen by leaving out blocks of ten seconds, of which the others allow 98 %"
    )
    said, _ = learn(capsys, takes, tmp_path, *pair, "--margin", 6)
    assert said.startswith("widths of keyframes are chosen by leaving out each of 3 takes")


def test_margins_between_people_are_added(capsys, takes, tmp_path):
    sizes = ("--joints", "LeftUpLeg:LeftLeg", "--voxel", 20, "--keyframe-width", 40, "--margin", 4)
    _, rows = learn(capsys, takes, tmp_path, *sizes, "--person-margin", 8)
    assert margins(rows, "LeftUpLeg", "LeftLeg") == [12.0, 12.0]
    told = fails(capsys, "limits", "learn", *takes, "-o", tmp_path / "x.npz", *sizes, "--person-margin", -1)
    assert "--person-margin is -1; it must be between 0 and 90 degrees" in told


def test_both_sides_double_the_samples(capsys, takes, tmp_path):
    sizes = ("--joints", "LeftUpLeg", "--voxel", 20)
    counts = [
        int(learn(capsys, takes, tmp_path, *sizes, *more)[1]["LeftUpLeg"][3])
        for more in ((), ("--both-sides",))
    ]
    assert counts == [1200, 2400]
    told = fails(
        capsys, "limits", "learn", takes[0], "-o", tmp_path / "x.npz", "--joints", "Spine", "--both-sides"
    )
    assert "'Spine' is no recognised hip, knee" in told


def test_conventions_of_tables(capsys, tmp_path):
    table = tmp_path / "knee.csv"
    angles = 4 * np.sin(np.arange(300) / 20)
    rows = [f"{frame / 30},{angle}" for frame, angle in enumerate(angles)]
    table.write_text("\n".join(["time,knee_angle_r", *rows]) + "\n")
    options = ("limits", "learn", table, "-o", tmp_path / "l.npz", "--joints", "knee_r", "--convention")
    told = fails(capsys, *options, "isb")
    assert (
        "looks like radians; give --convention isb-radians, or --convention isb-degrees if they are degrees"
        in told
    )
    # the advice helps
    said = runs(capsys, *options, "isb-degrees")
    assert {line.split()[0]: line.split() for line in said.splitlines()}["knee_r"][4] == "8°"
