"""`jaxcap convert`: motions, points and bodies for other programs, read again by others' readers."""

import ezc3d
import numpy as np
import pytest
import trimesh
from c3d_bytes import c3d_bytes
from command_line import fails, runs, tree, write_inputs

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.body.kinematics import joint_paths
from jaxcap.io.archives.npz import load_body, load_motion, load_skeleton, save_motion
from jaxcap.io.meshes.vertex_list import read_vertex_list
from jaxcap.io.registry import read_marker_file, read_markers, write_markers
from jaxcap.io.skeletons.amass import write_amass
from jaxcap.io.skeletons.bvh import read_bvh, write_bvh
from jaxcap.observe.markers import make_markers


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return write_inputs(tmp_path_factory.mktemp("inputs"))


def same_motion(found, motion, atol):
    np.testing.assert_allclose(found.poses.translations, motion.poses.translations, atol=atol)
    apart = 1 - np.abs(np.sum(np.asarray(found.poses.rotations) * np.asarray(motion.poses.rotations), -1))
    assert apart.max() < atol


@pytest.mark.parametrize("suffix", ["c3d", "trc"])
def test_joint_centres_in_other_programs_files(inputs, tmp_path, capsys, suffix):
    """From BVH as well; in millimetres, or in the unit that is asked for."""
    body, motion = load_body(inputs / "body.npz"), load_motion(inputs / "truth.npz")
    joints = np.asarray(joint_paths(body.skeleton, motion.poses))
    write_bvh(tmp_path / "truth.bvh", body.skeleton, motion)
    named = list(body.skeleton.names)
    for source, unit in (
        (inputs / "truth.npz", "mm"),
        (inputs / "truth.npz", "m"),
        (tmp_path / "truth.bvh", "mm"),
    ):
        path = tmp_path / f"{source.suffix[1:]}-{unit}.{suffix}"
        told = runs(capsys, "convert", source, path, *(() if unit == "mm" else ("--target-unit", unit)))
        assert "31 joint centres, 5 frames at 30 frames per second" in told
        back = read_markers(path)
        assert back.rate == 30.0
        assert bool(np.asarray(back.visible).all())
        at = [back.labels.index(name) for name in named]
        np.testing.assert_allclose(np.asarray(back.positions)[:, at], joints, atol=1e-6)
    if suffix == "c3d":
        file = ezc3d.c3d(str(tmp_path / "npz-mm.c3d"))
        point = file["parameters"]["POINT"]
        assert point["LABELS"]["value"] == named
        assert (point["UNITS"]["value"], point["RATE"]["value"].tolist()) == (["mm"], [30.0])
        np.testing.assert_allclose(
            file["data"]["points"][:3].transpose(2, 1, 0), 1000 * joints, rtol=1e-6, atol=1e-4
        )
    else:
        lines = (tmp_path / "npz-mm.trc").read_text().splitlines()
        assert lines[2].split("\t")[:5] == ["30", "30", "5", "31", "mm"]
        assert lines[3].split("\t")[2::3][:31] == named
        row = [float(cell) for cell in lines[7].split("\t")]
        np.testing.assert_allclose(row[:2], [2, 1 / 30], atol=1e-6)
        np.testing.assert_allclose(row[2:], 1000 * joints[1].reshape(-1), atol=1e-4)


def test_joint_angles(inputs, tmp_path, capsys):
    skeleton, motion = load_skeleton(inputs / "body.npz"), load_motion(inputs / "truth.npz")
    expected = jc.joint_angles(skeleton, motion).to_degrees()
    write_bvh(tmp_path / "truth.bvh", skeleton, motion)
    write_amass(tmp_path / "amass.npz", skeleton, motion)
    for source, *options in (
        (inputs / "truth.npz",),
        (tmp_path / "truth.bvh",),
        (tmp_path / "amass.npz", "--body", inputs / "body.npz"),
    ):
        path = tmp_path / f"{source.stem}{source.suffix[1:]}.csv"
        told = runs(capsys, "convert", source, path, "--as", "angles", *options)
        assert f"{len(expected.names)} joint angles in degrees, 5 frames at 30 frames per second" in told
        assert f"joint angles: {len(expected.names)}, in degrees (pelvis_rotation" in runs(
            capsys, "info", path
        )
        table = np.genfromtxt(path, delimiter=",", skip_header=2 + len(expected.names), names=True)
        for name in expected.names:
            np.testing.assert_allclose(table[name], expected[name], atol=1e-3)
    chain = jc.make_skeleton(
        ["a", "b"], [-1, 0], ["free", "ball"], np.array([[0, 0, 0], [0, -0.4, 0]], float)
    )
    save_motion(tmp_path / "chain.npz", jc.stack_poses([jc.rest_pose(chain)]), chain)
    said = fails(capsys, "convert", tmp_path / "chain.npz", tmp_path / "chain.csv", "--as", "angles")
    assert "chain.npz: The joints a, b are not recognised as a person" in said


def test_the_surface_of_a_body_becomes_meshes(inputs, tmp_path, capsys):
    """At rest, and in each frame of a motion, in the given unit."""
    body, motion = load_body(inputs / "body.npz"), load_motion(inputs / "truth.npz")
    said = runs(capsys, "convert", inputs / "body.npz", tmp_path / "rest.obj", "--target-unit", "mm")
    assert f"{len(body.vertices)} vertices, {len(body.faces)} faces, at rest" in said
    # read by another library
    rest = trimesh.load(tmp_path / "rest.obj", process=False)
    np.testing.assert_allclose(rest.vertices, 1000 * body.vertices, atol=1e-3)
    np.testing.assert_array_equal(rest.faces, body.faces)
    pattern = tmp_path / "50%_%02d.ply"
    said = runs(capsys, "convert", inputs / "truth.npz", pattern, "--body", inputs / "body.npz")
    assert "5 meshes, 1500 vertices" in said
    wanted = jc.body.posed_vertices(body, motion.poses)
    for frame in range(5):
        found = trimesh.load(tmp_path / f"50%_{frame:02d}.ply", process=False).vertices
        np.testing.assert_allclose(found, wanted[frame], atol=1e-5)
    said = fails(capsys, "convert", inputs / "body.npz", pattern, "--motion", inputs / "truth.npz")
    assert "50%_00.ply: this file already exists" in said
    # a name with a number is for frames
    for source in (inputs / "body.npz", tmp_path / "rest.obj"):
        said = fails(capsys, "convert", source, tmp_path / "rest_%02d.obj")
        assert "the name has a frame number, but there is no motion; give --motion" in said
        assert not (tmp_path / "rest_%02d.obj").exists()


def test_a_skinned_body_moves_as_meshes(inputs, tmp_path, capsys):
    """By its own clip, and by another motion."""
    body, motion = load_body(inputs / "body.npz"), load_motion(inputs / "truth.npz")
    skinned = tmp_path / "body.glb"
    runs(capsys, "convert", inputs / "body.npz", skinned, "--motion", inputs / "truth.npz")
    wanted = jc.body.posed_vertices(body, motion.poses)
    for name, *options in (("clip",), ("given", "--motion", inputs / "truth.npz")):
        said = runs(capsys, "convert", skinned, tmp_path / f"{name}_%02d.ply", *options)
        assert "5 meshes, 1500 vertices" in said
        found = trimesh.load(tmp_path / f"{name}_04.ply", process=False).vertices
        assert np.linalg.norm(found - wanted[4], axis=1).mean() < 0.005
    said = fails(capsys, "convert", skinned, tmp_path / "one.ply", "--motion", inputs / "truth.npz")
    assert "give a name with the number of the frame" in said


def test_vertices_become_markers(inputs, tmp_path, capsys):
    body, motion = load_body(inputs / "body.npz"), load_motion(inputs / "truth.npz")
    (tmp_path / "head.txt").write_text("# two on the head\nLFHD 7\nRFHD 1499\n\n12\n")
    assert read_vertex_list(tmp_path / "head.txt") == {"LFHD": 7, "RFHD": 1499, "v12": 12}
    told = runs(
        capsys, "convert", inputs / "truth.npz", tmp_path / "all.c3d", "--body", inputs / "body.npz",
        "--vertices", tmp_path / "head.txt", "SACR=900", "33",
    )  # fmt: skip
    assert "31 joint centres and 5 markers" in told
    back = read_markers(tmp_path / "all.c3d")
    assert back.labels == (*body.skeleton.names, "LFHD", "RFHD", "v12", "SACR", "v33")
    expected = np.asarray(posed_vertices(body, motion.poses))[:, [7, 1499, 12, 900, 33]]
    np.testing.assert_allclose(np.asarray(back.positions)[:, 31:], expected, atol=1e-6)
    # and from one format of markers to another
    runs(capsys, "convert", tmp_path / "all.c3d", tmp_path / "all.trc")
    again = read_markers(tmp_path / "all.trc")
    assert (again.labels, again.rate) == (back.labels, back.rate)
    np.testing.assert_allclose(again.positions, back.positions, atol=1e-8)


@pytest.mark.parametrize("suffix", ["c3d", "csv"])
def test_markers_of_an_unlikely_size_are_refused(tmp_path, capsys, rng, suffix):
    """People of 1.7 km and of 1.7 mm, also if two of them are in one file; --unit overrides the unit of the file."""
    places = rng.random((4, 30, 3)) * [0.5, 0.6, 1.7]
    places[:, 15:] += [8.0, 0.0, 0.0]
    labels = [f"{'Anna' if i < 15 else 'Ben'}:M{i}" for i in range(30)]
    for factor, likely in ((1.0, None), (1000.0, "mm"), (0.001, None)):
        source, target = tmp_path / f"a.{suffix}", tmp_path / f"{factor:g}.trc"
        if suffix == "csv":
            write_markers(source, make_markers(places, labels, 100.0), 1 / factor)
        else:
            source.write_bytes(c3d_bytes(factor * places, labels, unit="m"))
        if factor == 1.0:
            runs(capsys, "convert", source, target)
            continue
        line = fails(capsys, "convert", source, target)
        assert "the markers of a frame extend over" in line and not target.exists()
        if likely:
            assert "give --unit mm if it is, or --unit m if the size is right" in line
        runs(capsys, "convert", source, target, "--unit", "m")
        np.testing.assert_allclose(
            read_marker_file(target).frames.positions, factor * places, rtol=1e-4, atol=1e-6
        )
        runs(capsys, "convert", source, target, "--unit", str(1 / factor), "--overwrite")
        np.testing.assert_allclose(read_marker_file(target).frames.positions, places, atol=1e-3)


def test_amass_there_and_back(inputs, tmp_path, capsys):
    motion = load_motion(inputs / "truth.npz")
    told = runs(capsys, "convert", inputs / "truth.npz", tmp_path / "a.npz", "--as", "amass")
    assert "5 frames at 30 frames per second" in told
    runs(capsys, "convert", tmp_path / "a.npz", tmp_path / "back.npz")
    assert load_skeleton(tmp_path / "back.npz").names == load_skeleton(inputs / "truth.npz").names
    same_motion(load_motion(tmp_path / "back.npz"), motion, 1e-12)
    # one that does not know its skeleton, with y up, as others write it
    with np.load(tmp_path / "a.npz") as file:
        bare = {name: file[name] for name in file.files if not name.startswith("skeleton.")}
    np.savez(tmp_path / "bare.npz", **bare)
    assert "--body" in fails(capsys, "convert", tmp_path / "bare.npz", tmp_path / "b.bvh")
    with_body = ("convert", tmp_path / "bare.npz", tmp_path / "b.npz", "--body", inputs / "body.npz")
    runs(capsys, *with_body)
    same_motion(load_motion(tmp_path / "b.npz"), motion, 1e-12)
    runs(capsys, *with_body, "--up", "y", "--overwrite")
    lying = np.asarray(load_motion(tmp_path / "b.npz").poses.rotations)[0, 0]
    np.testing.assert_allclose(np.abs(lying[:2]), np.sqrt(0.5), atol=0.05)


def test_a_body_with_a_motion_of_amass_becomes_usd_and_glb(inputs, tmp_path, capsys):
    body, motion = load_body(inputs / "body.npz"), load_motion(inputs / "truth.npz")
    write_amass(tmp_path / "a.npz", body.skeleton, motion)
    for name in ("body.usda", "body.glb"):
        told = runs(capsys, "convert", inputs / "body.npz", tmp_path / name, "--motion", tmp_path / "a.npz")
        assert "1500 vertices, 31 joints" in told
        assert "over 5 frames" in told
    assert (tmp_path / "body.usda").read_text().startswith("#usda")
    # the animation of a .glb is a motion
    runs(capsys, "convert", tmp_path / "body.glb", tmp_path / "m.bvh")
    skeleton, back = read_bvh(tmp_path / "m.bvh")
    at = [skeleton.names.index(name) for name in body.skeleton.names]
    there = np.asarray(joint_paths(skeleton, back.poses))[:, at]
    np.testing.assert_allclose(there, joint_paths(body.skeleton, motion.poses), atol=1e-5)
    runs(capsys, "convert", inputs / "body.npz", tmp_path / "still.glb")
    assert "no animation" in fails(capsys, "convert", tmp_path / "still.glb", tmp_path / "s.bvh")
    # and its skin a body
    told = runs(capsys, "convert", tmp_path / "body.glb", tmp_path / "again.npz", "--as", "body")
    assert "1500 vertices, 31 joints" in told
    again = load_body(tmp_path / "again.npz")
    np.testing.assert_allclose(again.vertices, body.vertices, atol=1e-6)
    told = runs(capsys, "info", tmp_path / "body.glb")
    assert "motion: 5 frames" in told and "1500 vertices" in told and "LinearSkin" in told
    words = ("convert", inputs / "truth.npz", tmp_path / "c.npz", "--as", "body")
    assert "body" in fails(capsys, *words)
    assert not (tmp_path / "c.npz").exists()


def test_a_motion_of_a_body(inputs, tmp_path, capsys):
    """BVH in metres is matched to the body's joints by name."""
    body, motion = load_body(inputs / "body.npz"), load_motion(inputs / "truth.npz")
    write_bvh(tmp_path / "m.bvh", body.skeleton, motion, "m")
    runs(
        capsys, "convert", tmp_path / "m.bvh", tmp_path / "m.npz", "--body", inputs / "body.npz", "--unit", "m"
    )  # fmt: skip
    assert load_skeleton(tmp_path / "m.npz").kinds == body.skeleton.kinds
    same_motion(load_motion(tmp_path / "m.npz", body.skeleton), motion, 1e-6)


def test_the_human_is_a_body_without_a_file(inputs, tmp_path, capsys):
    runs(capsys, "convert", "human:low", tmp_path / "a.glb", "--motion", inputs / "truth.npz")
    assert "1500 vertices" in runs(capsys, "convert", "human:low", tmp_path / "human.npz")
    low = jc.human(resolution="low", joints="tracking")
    np.testing.assert_array_equal(jc.load_body(tmp_path / "human.npz").vertices, low.vertices)
    told = fails(capsys, "convert", "human:low", tmp_path / "b.npz", "--motion", inputs / "truth.npz")
    assert "--motion is for bodies that are written as .glb" in told
    runs(capsys, "convert", inputs / "body.npz", tmp_path / "b.glb", "--motion", inputs / "truth.npz")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    runs(
        capsys, "convert", inputs / "truth.npz", tmp_path / "a.trc", "--body", "human:low", "--vertices", "7"
    )
    assert "'huge' is not an option" in fails(capsys, "convert", "human:huge", tmp_path / "c.glb")


def test_wrong_combinations_are_told(inputs, tmp_path, capsys):
    body, motion, out = inputs / "body.npz", inputs / "truth.npz", tmp_path / "out"
    (tmp_path / "three.txt").write_text("LFHD 7 8\n")
    (tmp_path / "words.txt").write_text("LFHD seven\n")
    (tmp_path / "none.txt").write_text("# nobody\n")
    (tmp_path / "minus.txt").write_text("LFHD -3\n")
    (tmp_path / "twice.txt").write_text("LFHD 3\nLFHD 4\n")
    marked = (motion, "out.trc", "--body", body, "--vertices")
    skeleton = load_body(body).skeleton
    save_motion(inputs / "still.npz", load_motion(motion).slice(slice(0, 0)), skeleton)
    before = tree(tmp_path)
    for source, target, *options, said in (
        (motion, "out.fbx", "'.fbx' files cannot be written; write .glb"),
        (motion, "out.gltf", "'.gltf' files cannot be written; write .glb"),
        ("human", "out.gltf", "'.gltf' files cannot be written; write .glb"),
        (
            "human",
            "out.trc",
            "human: the embedded body cannot be converted to '.trc' files; write it as .glb",
        ),
        (motion, "out.ply", "a motion has no surface to write as '.ply' files; give its body with --body"),
        (
            motion,
            "out.ply",
            "--body",
            body,
            "a mesh is one of them; give a name with the number of the frame, such as out_%04d.ply",
        ),
        (motion, "out.bvh", "--rate", "25", "other motions state their rate"),
        (motion, "out.foo", "cannot be converted to '.foo' files; motions are read from"),
        (motion, "out.trc", "--motion", motion, "--motion is for bodies that are written as .glb"),
        (motion, "out.trc", "--as", "amass", "--as amass is for motions that are written as .npz"),
        (motion, "out.bvh", "--as", "amass", "is written as .npz"),
        (
            motion,
            "out.bvh",
            "--as",
            "angles",
            "--as angles is written as .csv or .mot or .sto; give a name that ends in .csv",
        ),
        (motion, "out.csv", "--as", "angles", "--target-unit", "mm", "joint angles are written in degrees"),
        (motion, "out.csv", "--as", "angles", "--body", body, "--vertices", "7", "--vertices is for motions"),
        (motion, "out.bvh", "--up", "y", "other motions have y up"),
        (body, "out.glb", "--up", "y", "other motions have y up"),
        (motion, "out.bvh", "--vertices", "7", "--vertices is for motions that are written as .trc"),
        (motion, "out.trc", "--vertices", "7", "give it with --body"),
        (motion, "out.bvh", "--unit", "mm", "'.npz' files have a known unit"),
        (motion, "out.npz", "--target-unit", "mm", "'.npz' files are written in metres"),
        (body, "out.usda", "--target-unit", "mm", "'.usda' files are written in metres"),
        (
            motion,
            "out.bvh",
            "--influences",
            "8",
            "--influences is for bodies that are written as .glb or USD",
        ),
        (motion, "out.bvh", "--tolerance", "1", "--tolerance is for bodies that are written as .glb or USD"),
        (body, "out.skl", "--body", body, "--body is for motions"),
        (
            motion,
            "out.usda",
            "this is a motion (5 frames); expected a body (from `jaxcap rig`, `learn` or `adapt`); `jaxcap info",
        ),
        (
            body,
            "out.bvh",
            "this is a body (1500 vertices); expected a motion (from `jaxcap track`, `fit` or `adapt`)",
        ),
        (*marked, "LFHD", "neither a vertex"),
        (*marked, "a=1", "a=2", "named 'a'"),
        (*marked, "1500", "the vertices of the body are 0 to 1499"),
        (*marked, "Head=7", "a joint already has the name 'Head'"),
        (*marked, tmp_path / "three.txt", "three.txt:1"),
        (*marked, tmp_path / "words.txt", "not a whole number"),
        (*marked, tmp_path / "none.txt", "no vertices"),
        (*marked, tmp_path / "minus.txt", "expected an index of at least 0"),
        (*marked, tmp_path / "twice.txt", "occurs twice"),
        (tmp_path / "none.npz", "out.bvh", "no such file"),
        (inputs / "still.npz", "out.bvh", "this motion has no frames"),
        (body, "out.glb", "--motion", inputs / "still.npz", "this motion has no frames"),
    ):
        assert said in fails(capsys, "convert", source, out.with_name(target), *options)
    assert tree(tmp_path) == before
