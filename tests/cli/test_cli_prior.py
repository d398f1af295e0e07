"""`jaxcap prior` as a user types it: learned, told, written with a body, and what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs

import jaxcap as jc
from jaxcap.adapt.shape.shape_prior import shape_energy
from jaxcap.body.body import posed_vertices
from jaxcap.body.people.sample import sample_poses
from jaxcap.cli import main
from jaxcap.cli.prior.learn import same_bones
from jaxcap.io.archives.npz import load_body_limits
from jaxcap.io.archives.prior import load_shape_prior
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from tests.cli.test_cli_limits import SKELETON, write_motion


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("prior")
    for seed in range(2):
        write_motion(folder / f"m{seed}.npz", seed)
    vertices = jnp.asarray([[0.0, 1, 0], [0.2, 1.4, 0], [0.5, 1.4, 0], [0.6, 1.4, 0.1]])
    faces = jnp.asarray([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    skin = jc.body.RigidSkin(jnp.asarray([0, 1, 2, 2]))
    jc.save_body(folder / "body.npz", jc.Body(SKELETON, skin, vertices, faces), {"angles": np.ones(2)})
    return folder


def test_help_tells_the_verbs(capsys):
    for words in (["prior", "--help"], ["prior", "learn", "--help"], ["prior", "info", "--help"]):
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert not stop.value.code
    assert "jaxcap prior" in capsys.readouterr().out


def test_learn_and_info(capsys, folder):
    out = folder / "prior.npz"
    told = runs(
        capsys,
        "prior",
        "learn",
        folder / "m0.npz",
        folder / "m1.npz",
        "-o",
        out,
        "--max-gaussians",
        4,
        "--rate",
        10,
    )
    assert "learning from 2 motions, 600 poses" in told
    row = next(line.split() for line in told.splitlines() if line.startswith("shoulder, elbow"))
    gaussians, single, chosen, zeroed, couplings = (
        int(row[2]),
        float(row[3]),
        float(row[4]),
        int(row[5]),
        int(row[7]),
    )
    assert 1 <= gaussians <= 4
    assert chosen >= single
    assert 0 <= zeroed <= couplings == 15 * gaussians
    prior = jc.io.load_prior(out, SKELETON)
    assert prior.pairs == (("shoulder", "elbow"),)
    assert prior.weights.shape == (1, gaussians)
    told = runs(capsys, "prior", "info", out)
    assert "1 pairs of joints" in told
    ranges = next(line for line in told.splitlines() if line.startswith("elbow"))
    # a hinge about its third axis, bent by 80 degrees
    assert ranges.split()[1:] == ["0°", "to", "0°", "0°", "to", "0°", "0°", "to", "80°"]
    runs(
        capsys,
        "prior",
        "learn",
        folder / "m0.npz",
        "-o",
        folder / "wide.npz",
        "--max-gaussians",
        1,
        "--margin",
        5,
    )
    told = runs(capsys, "prior", "info", folder / "wide.npz")
    ranges = next(line for line in told.splitlines() if line.startswith("elbow"))
    assert ranges.split()[1:3] == ["-5°", "to"]


def test_a_body_carries_its_prior(capsys, folder):
    out = folder / "with.npz"
    runs(
        capsys,
        "prior",
        "learn",
        folder / "m0.npz",
        "--body",
        folder / "body.npz",
        "-o",
        out,
        "--max-gaussians",
        1,
    )
    assert len(jc.load_body(out).vertices) == 4
    assert jc.io.load_prior(out, SKELETON).pairs == (("shoulder", "elbow"),)
    np.testing.assert_array_equal(load_body_limits(out)["angles"], np.ones(2))
    assert "pose prior" in runs(capsys, "prior", "info", out)
    assert "body: 4 vertices" in runs(capsys, "info", out)


def test_what_is_refused(capsys, folder, tmp_path):
    m, out = folder / "m0.npz", tmp_path / "p.npz"
    learn = ("prior", "learn", m, "-o", out)
    assert "--rate is 0" in fails(capsys, *learn, "--rate", 0)
    assert "--max-gaussians is 0" in fails(capsys, *learn, "--max-gaussians", 0)
    assert "--min-deviation is 90" in fails(capsys, *learn, "--min-deviation", 90)
    assert "--seed is -1" in fails(capsys, *learn, "--seed", -1)
    assert "--margin is 200; it must be between 0 and 180" in fails(capsys, *learn, "--margin", 200)
    assert "written as .npz" in fails(capsys, "prior", "learn", m, "-o", tmp_path / "p.txt")
    assert "already exists" in fails(capsys, "prior", "learn", m, "-o", folder / "body.npz")
    assert "folder does not exist" in fails(capsys, "prior", "learn", m, "-o", tmp_path / "none" / "p.npz")
    assert "no motions" in fails(capsys, "prior", "learn", "-o", out)
    assert "no such file" in fails(capsys, "prior", "learn", tmp_path / "none.npz", "-o", out)
    (tmp_path / "a.fbx").touch()
    said = fails(capsys, "prior", "learn", tmp_path / "a.fbx", "-o", out)
    assert "this is an FBX file, which is not read; export .glb from Blender" in said
    other = jc.make_skeleton(("a", "b", "c"), (-1, 0, 1), ("free", "ball", "ball"), np.eye(3))
    still = tmp_path / "other.npz"
    jc.save_motion(still, jc.stack_poses([jc.rest_pose(other)] * 2), other)
    told = fails(capsys, "prior", "learn", m, still, "-o", out)
    assert "this motion has the joints a, b, c" in told
    assert "of one skeleton" in told
    # carried over it is, where names tell which joint is which
    told = fails(capsys, "prior", "learn", still, "--body", folder / "body.npz", "-o", out)
    assert str(still) in told
    assert "There are 2 poses" in fails(capsys, "prior", "learn", still, "-o", out)
    assert "the file contains no pose prior" in fails(capsys, "prior", "info", folder / "body.npz")
    assert "expected a pose prior (from `jaxcap prior learn`) or a body" in fails(capsys, "prior", "info", m)
    assert not out.exists()


def test_motions_of_another_skeleton_are_carried_over(capsys, tmp_path):
    human = jc.human(joints="tracking", resolution="low")
    taller = jc.human(joints="tracking", resolution="low", height=1.95)
    poses = sample_poses(taller.skeleton, 40)
    jc.save_motion(tmp_path / "own.npz", jc.Motion(poses, 30.0), taller.skeleton)
    centres = np.array(taller.skeleton.centres)
    # an elbow, and what hangs on it, elsewhere at rest
    centres += 0.02 * taller.skeleton.descendants[taller.skeleton.index("LeftForeArm")][:, None]
    other = eqx.tree_at(lambda s: s.centres, taller.skeleton, centres)
    assert same_bones(human.skeleton, taller.skeleton)
    assert not same_bones(human.skeleton, other)
    jc.save_motion(tmp_path / "other.npz", jc.Motion(poses, 30.0), other)
    told = runs(capsys, "prior", "learn", tmp_path / "own.npz", tmp_path / "other.npz", "--body", "human:low", "-o", tmp_path / "p.npz", "--max-gaussians", 1)  # fmt: skip
    assert "1 of 2 motions retargeted to the skeleton of human:low" in told
    assert jc.io.load_prior(tmp_path / "p.npz", human.skeleton).pairs


@pytest.fixture(scope="module")
def person(tmp_path_factory):
    """`low.npz`, a small human; four meshes of it, posed; and poses to learn a prior from."""
    folder = tmp_path_factory.mktemp("shape")
    body = jc.human(resolution="low", joints="tracking")
    jc.save_body(folder / "low.npz", body)
    poses = sample_poses(body.skeleton, 40)
    jc.save_motion(folder / "motion.npz", jc.Motion(poses, 30.0), body.skeleton)
    (folder / "meshes").mkdir()
    four = jax.tree.map(lambda a: a[:4], poses)
    four = jc.Pose(four.translations.at[:, 0].add(0.3), four.rotations, four.scale)
    faces = np.asarray(body.faces)
    for number, vertices in enumerate(np.asarray(posed_vertices(body, four), float)):
        write_mesh(folder / "meshes" / f"m{number}.obj", Mesh(vertices, faces, None))
    return folder, body


def test_shape_is_learned_from_meshes_of_the_body(capsys, person):
    folder, body = person
    out, motion = folder / "prior.npz", folder / "motion.npz"
    words = ("--body", folder / "low.npz", "--meshes", folder / "meshes" / "*.obj", "--max-gaussians", 1)
    told = runs(capsys, "prior", "learn", motion, "-o", out, *words)
    assert "shape: 4 of 4 meshes; RMS error of the body 0.00 mm, of its Laplacian vectors 0.00 mm" in told
    prior = load_shape_prior(out, jc.load_body(out))
    assert prior is not None
    assert prior.vectors.shape == (4, len(body.vertices), 3)
    assert shape_energy(prior, body) < 1e-10
    rough = eqx.tree_at(lambda b: b.vertices, body, body.vertices.at[::7].add(0.005))
    assert shape_energy(prior, rough) > 1e-6
    assert f"{len(body.vertices)} vertices in 4 meshes" in runs(capsys, "prior", "info", out)
    # a prior of poses learned anew leaves the shape as it is
    runs(capsys, "prior", "learn", motion, "-o", out, "--body", out, "--max-gaussians", 1, "--overwrite")
    again = load_shape_prior(out, body)
    assert again is not None
    np.testing.assert_array_equal(again.vectors, prior.vectors)


def test_of_many_meshes_those_posed_most_unlike_are_kept(capsys, monkeypatch, person):
    folder, _ = person
    monkeypatch.setattr("jaxcap.cli.prior.shape.MOST_MESHES", 2)
    out = folder / "two.npz"
    words = ("--body", folder / "low.npz", "--meshes", folder / "meshes", "--max-gaussians", 1)
    told = runs(capsys, "prior", "learn", folder / "motion.npz", "-o", out, *words)
    assert "shape: 2 of 4 meshes" in told
    assert "in 2 meshes" in runs(capsys, "prior", "info", out)


def test_meshes_that_are_refused(capsys, folder, person, tmp_path):
    meshes, out = person[0] / "meshes" / "*.obj", tmp_path / "p.npz"
    learn = ("prior", "learn", person[0] / "motion.npz", "-o", out)
    assert "give it with --body" in fails(capsys, *learn, "--meshes", meshes)
    body = (*learn, "--body", person[0] / "low.npz")
    assert "no such file" in fails(capsys, *body, "--meshes", tmp_path / "none.obj")
    assert "with --unit" in fails(capsys, *body, "--meshes", meshes, "--unit", "mm")
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]), None)
    write_mesh(tmp_path / "small.obj", mesh)
    told = fails(capsys, *body, "--meshes", tmp_path / "small.obj")
    assert "The meshes have 3 vertices; expected the" in told
    assert not out.exists()
