"""What an adaptation knows of the actor beforehand: which file it is in, and what of it is in the actor's."""

import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import make_scene, words, write_folder
from command_line import runs

import jaxcap as jc
from jaxcap.adapt.task import AdaptSettings, AdaptState, plan_stages
from jaxcap.body.pose import stack_poses
from jaxcap.cli.adapt.adapt import Adapt
from jaxcap.cli.adapt.input import RunFiles, check_input
from jaxcap.cli.adapt.prior import carried_arrays, prior_file, read_priors
from jaxcap.cli.adapt.state import fingerprint_of, keep_state
from jaxcap.energy.priors.pair_likelihood import MahalanobisPrior
from jaxcap.io.archives import archive
from jaxcap.io.archives.journal import hash_files
from jaxcap.io.archives.npz import load_body_limits
from jaxcap.io.archives.prior import has_prior, load_boxes, load_priors
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.limits.rotation_vector_boxes import make_pose_boxes
from jaxcap.prior.pair_prior import successive_pairs


@pytest.fixture(scope="module")
def scene():
    return make_scene()


@pytest.fixture(scope="module")
def known(scene):
    """A prior of poses, ranges and a shape of the template."""
    template, _, poses, _ = scene
    skeleton = template.skeleton
    pairs = successive_pairs(skeleton)[:2]
    frames = [[skeleton.orientations[skeleton.index(name)] for name in pair] for pair in pairs]
    eyes = np.tile(3 * np.eye(6), (2, 1, 1, 1))
    prior = jc.prior.make_pair_prior(pairs, np.array(frames), np.ones((2, 1)), np.full((2, 1, 6), 0.01), eyes)
    boxes = make_pose_boxes([pairs[0][0]], -np.ones((1, 3)), np.ones((1, 3)))
    meshes = np.asarray(template.vertices, float)[None] + 0.01
    shape = jc.adapt.make_shape_prior(template, stack_poses(poses[:1], 1.0).poses, meshes)
    return prior, boxes, shape


@pytest.fixture
def folder(scene, known, tmp_path):
    """A template that carries all three, with limits of its own."""
    prior, boxes, shape = known
    folder = write_folder(tmp_path, scene)
    jc.io.save_prior(folder / "body.npz", prior, boxes, scene[0], {"angles": np.arange(3.0)}, shape)
    jc.io.save_prior(folder / "other.npz", prior)
    jc.save_body(folder / "plain.npz", scene[0])
    return folder


def test_nothing_is_read_twice(scene, known, folder, monkeypatch):
    opened, opening = [], zipfile.ZipFile.__init__
    read, numbers = [], archive._numbers
    monkeypatch.setattr(
        zipfile.ZipFile, "__init__", lambda file, *given: opened.append(given) or opening(file, *given)
    )
    monkeypatch.setattr(
        archive, "_numbers", lambda file, *more: read.append(more[0].filename) or numbers(file, *more)
    )
    found = load_priors(folder / "body.npz", scene[0])
    assert len(opened) == 1
    assert len(read) == len(set(read)) > 9
    assert found.boxes is not None and found.shape is not None
    np.testing.assert_array_equal(found.prior.means, known[0].means)
    np.testing.assert_array_equal(found.boxes.upper, known[1].upper)
    np.testing.assert_allclose(found.shape.vectors, known[2].vectors, rtol=1e-6)
    assert load_priors(folder / "body.npz", scene[0], shape=False).shape is None
    alone = load_priors(folder / "other.npz", scene[0])
    assert alone.boxes is None and alone.shape is None
    with pytest.raises(jc.InputError, match="the file contains no pose prior"):
        load_priors(folder / "plain.npz", scene[0])


def test_which_file_counts(folder):
    body, plain = (str(folder / name) for name in ("body.npz", "plain.npz"))
    assert has_prior(body) and not has_prior(plain)
    assert prior_file(body, None) == folder / "body.npz"
    assert prior_file(body, folder / "other.npz") == folder / "other.npz"
    assert prior_file(body, folder / "none") == folder / "none"
    assert prior_file(body, type(folder)("none")) is None
    assert prior_file(plain, None) is None
    assert prior_file("human:female", None) is None
    assert prior_file(plain, folder / "other.npz") == folder / "other.npz"
    assert set(carried_arrays(body, None)) == {"angles"}
    assert carried_arrays(plain, None) == carried_arrays("human", None) == {}


def test_a_prior_in_the_template_counts_as_one_that_is_named(scene, folder):
    scans = read_clouds(str(folder / "*.ply"))
    asked = Adapt(str(folder / "body.npz"), (str(folder / "*.ply"),), folder / "a.npz")
    own = read_priors(folder / "body.npz", scene[0], from_template=True, reduced=False)
    task, without = (asked.task(scene[0], scans, RunFiles(priors=priors)) for priors in (own, None))
    assert own is not None
    named = asked.task(scene[0], scans, RunFiles(priors=load_priors(folder / "body.npz", scene[0])))
    assert task.boxes is not None and named.boxes is not None and task.shape_prior is not None
    assert without.boxes is None and without.shape_prior is None
    ours, theirs, none = (jax.tree.leaves(one.prior) for one in (task, named, without))
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(ours) >= len(none) + len(jax.tree.leaves(MahalanobisPrior(own.prior)))


def test_of_a_reduced_template_its_own_shape_is_left_out(scene, folder, capsys):
    few = jc.Body(
        scene[0].skeleton, jc.body.RigidSkin(jnp.zeros(3, int)), jnp.eye(3), jnp.asarray([[0, 1, 2]])
    )
    priors = read_priors(folder / "body.npz", few, from_template=True, reduced=True)
    assert priors is not None and priors.boxes is not None and priors.shape is None
    assert "no shape prior, because of --vertices" in capsys.readouterr().out
    # one that is asked for is refused instead
    with pytest.raises(jc.InputError, match="and the body has 3"):
        read_priors(folder / "body.npz", few, from_template=False, reduced=True)


@pytest.mark.parametrize(
    ("more", "counts", "keeps"),
    [
        ((), "body.npz", True),
        (("--prior", "none"), None, False),
        (("--prior", "other.npz"), "other.npz", True),
    ],
)
def test_the_actor_carries_on_what_counted(scene, known, folder, capsys, monkeypatch, more, counts, keeps):
    """All stages are done; what is left is to write the files."""
    template, actor, poses, _ = scene
    monkeypatch.chdir(folder)
    asked = Adapt(str(folder / "body.npz"), (str(folder / "*.ply"),), folder / "a.npz", smoothness=0.0)
    digests = check_input(read_clouds(asked.clouds), template).digests
    file = None if counts is None else folder / counts
    header = {**asked.settings(), **hash_files({"prior": file}), **fingerprint_of(template, digests)}
    done = len(plan_stages(AdaptSettings(temporal_weight=0.0)))
    motion = stack_poses(poses, 30.0)
    keep_state(asked.checkpoint_path, AdaptState(done, actor, 1.1, motion, history=(("pose", 1.0),)), header)
    told = runs(capsys, *words(folder, "--smoothness", 0, "--resume", *more))
    line = "body.npz: the prior in this file is used (2 pairs of joints, ranges of 1 joints, the shape of 1 meshes)"
    assert (line in told) == (not more)
    skeleton, out = actor.skeleton, folder / "a.npz"
    np.testing.assert_array_equal(load_body_limits(out)["angles"], np.arange(3.0))
    assert has_prior(out) == keeps
    assert not [name for name in load_body_limits(out) if name.startswith("shape.")]
    np.testing.assert_array_equal(jc.load_body(out).vertices, actor.vertices)
    if keeps:
        np.testing.assert_array_equal(jc.io.load_prior(out, skeleton).means, known[0].means)
    assert (load_boxes(out, skeleton) is not None) == (not more)
