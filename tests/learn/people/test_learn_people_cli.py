"""`jaxcap learn --people`: the meshes of each person, the files that are written, and the verbs that take them."""

import json

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs
from helpers import random_pose

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import Motion, stack_poses, take_poses
from jaxcap.cli.learn import people as verb
from jaxcap.cli.learn.people_input import find_people, names_people, read_people
from jaxcap.errors import InputError
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.learn.people.learn_people import LearnedPeople, PeopleState
from jaxcap.learn.people.person import Person, repeat_meshes
from jaxcap.learn.people.shape_space import make_shape_space
from jaxcap.learn.skeleton.given_centres import GivenCentres
from tests.learn.people.made_limb import limb

SIZES = {"anna": (1.0, 0.06), "ben": (1.2, 0.07), "carl": (1.1, 0.05)}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Meshes of three people: two folders of files, and an archive; and their bodies and poses."""
    folder, rng = tmp_path_factory.mktemp("people"), np.random.default_rng(4)
    bodies = {name: limb(*size) for name, size in SIZES.items()}
    poses = {
        name: stack_poses([random_pose(body.skeleton, rng, 0.4) for _ in range(3)]).poses
        for name, body in bodies.items()
    }
    for name, body in bodies.items():
        vertices = np.asarray(posed_vertices(body, poses[name]))
        if name == "carl":
            jc.io.save_meshes(folder / "carl.npz", jc.MeshSequence(vertices, body.faces))
            continue
        (folder / name).mkdir()
        for number, mesh in enumerate(vertices):
            write_mesh(folder / name / f"{number}.ply", Mesh(mesh, np.asarray(body.faces)))
    return folder, bodies, poses


@pytest.fixture
def instant_learner(monkeypatch, scene):
    """In place of learning: the true bodies and poses. The arguments are kept."""
    _, bodies, poses = scene
    calls: dict = {}

    def learn_people(people, *, components, **options):
        calls.update(options, people=people)
        space = make_shape_space([bodies[name] for name in people], components)
        motions = tuple(
            Motion(take_poses(poses[name], np.arange(len(meshes))), meshes.rate)
            for name, meshes in people.items()
        )
        none = np.zeros((0, 2), int)
        return LearnedPeople(
            space.model,
            tuple(people),
            space.coefficients,
            motions,
            space.explained,
            none,
            (("round", 1.0),),
            symmetry_message="The two sides move differently.",
        )

    monkeypatch.setattr(verb, "learn_people", learn_people)
    return calls


def test_folders_archives_and_named_parts_are_people(scene, monkeypatch):
    folder, _, _ = scene
    monkeypatch.chdir(folder)
    found = find_people(["anna", "ben/*.ply", "carl.npz"])
    assert {name: len(files) for name, files in found.items()} == {"anna": 3, "ben": 3, "carl": 1}
    # files that a shell expanded, or a glob of folders
    assert list(find_people(["ben/0.ply", "anna/1.ply", "ben/2.ply"]).items()) == [
        ("ben", ["ben/0.ply", "ben/2.ply"]),
        ("anna", ["anna/1.ply"]),
    ]
    assert set(find_people(["[ab]*"])) == {"anna", "ben"}
    assert find_people(["[a-c]*"]) == find_people(["anna", "ben", "carl.npz"])
    assert find_people(["{subject}/*.ply"]) == find_people(["anna", "ben"])
    assert find_people(["{who}/{subject}.ply"]).keys() == {"0", "1", "2"}
    assert names_people(["{subject}/*.ply"]) and not names_people(["anna", "carl.npz"])
    with pytest.raises(
        InputError,
        match=r"parts a, b have names, and none of them names the person; call that part \{subject\}",
    ):
        find_people(["{a}/{b}.ply"])
    (folder / "more").mkdir(exist_ok=True)
    (folder / "more" / "anna.npz").write_bytes((folder / "carl.npz").read_bytes())
    with pytest.raises(InputError, match="two people are called anna, in anna and more/anna.npz"):
        find_people(["anna", "more/anna.npz"])


def test_a_folder_of_folders_is_no_person(scene, capsys, tmp_path):
    folder, _, _ = scene
    message = fails(capsys, "learn", folder, "--people", "-o", tmp_path / "model.npz")
    assert "contains folders with meshes" in message and f'"{folder}/{{subject}}/*.ply"' in message
    message = fails(capsys, "learn", folder / "anna", "--people", "-o", tmp_path / "model.npz")
    assert "there is one person, anna" in message and "{subject}_*.ply" in message


def test_people_keep_all_their_meshes_and_their_rates(scene, tmp_path):
    """Names of meshes are free, such as those of registered scans, and rates are those of each person's files."""
    folder, bodies, poses = scene
    sources, names = [str(folder / "anna")], ("scans.npz[0]", "[", "plain")
    for name, rate in (("ben", 60.0), ("carl", 25.0)):
        meshes = jc.MeshSequence(posed_vertices(bodies[name], poses[name]), bodies[name].faces, rate)
        jc.io.save_meshes(tmp_path / f"{name}.npz", meshes, names)
        sources.append(str(tmp_path / f"{name}.npz"))
    people, called = read_people(sources, "m", None)
    assert [len(meshes) for meshes in people.values()] == [3, 3, 3]
    assert [meshes.rate for meshes in people.values()] == [30.0, 60.0, 25.0]
    assert called["ben"][0].endswith("ben.npz[scans.npz[0]]") and len(called["ben"]) == 3
    np.testing.assert_allclose(people["ben"].vertices, posed_vertices(bodies["ben"], poses["ben"]), atol=1e-6)


def test_a_model_and_the_parameters_of_each_person_are_written(
    scene, instant_learner, tmp_path, monkeypatch, capsys
):
    folder, bodies, poses = scene
    monkeypatch.chdir(folder)
    out = tmp_path / "model.npz"
    printed = runs(
        capsys, "learn", "anna", "ben", "carl.npz", "--people", "-o", out, "--report", tmp_path / "report"
    )
    assert list(instant_learner["people"]) == ["anna", "ben", "carl"]
    assert "2 coefficients explain 100.0 % of the variance of 3 people at rest" in printed
    assert "The two sides move differently." in printed
    rows = [line.split() for line in printed.splitlines() if line.split()[:1] in (["anna"], ["carl"])]
    assert [row[:2] for row in rows] == [["anna", "3"], ["carl", "3"]]
    assert all(float(value) < 0.05 for row in rows for value in row[2:])
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    assert set(report["people"]) == {"anna", "ben", "carl"}
    # the model with the parameters of a person is the person
    model, (shape, _) = jc.read_body_model(out), jc.io.read_amass_shape(tmp_path / "model-motion-ben.npz")
    body = jc.shape_body(model, **shape)
    _, motion = jc.io.read_motion(tmp_path / "model-motion-ben.npz")
    np.testing.assert_allclose(
        posed_vertices(body, motion.poses), posed_vertices(bodies["ben"], poses["ben"]), atol=1e-6
    )
    described = runs(capsys, "info", out)
    assert (
        "body model: learned, 2 betas" in described and "learned from 3 people: anna, ben, carl" in described
    )
    # verbs that take a model take it
    runs(capsys, "fit", out, "anna", "-o", tmp_path / "fit.npz")
    coefficients = jc.io.read_model_people(out)["anna"]
    np.testing.assert_allclose(
        jc.io.read_amass_shape(tmp_path / "fit.npz")[0]["betas"], coefficients, atol=1e-3
    )
    runs(capsys, "convert", tmp_path / "model-motion-ben.npz", tmp_path / "ben.glb", "--body", out)
    there = jc.io.read_skinned(tmp_path / "ben.glb")[0]
    np.testing.assert_allclose(np.ptp(there.vertices, axis=0), np.ptp(body.vertices, axis=0), atol=1e-4)


def test_a_stopped_run_of_people_is_continued(scene, instant_learner, tmp_path, monkeypatch, capsys):
    folder, bodies, poses = scene
    monkeypatch.chdir(folder)
    out, learner = tmp_path / "model.npz", verb.learn_people

    def stopped(people, *, on_round, **options):
        state = PeopleState(
            tuple(
                repeat_meshes(
                    Person(
                        bodies[name],
                        poses[name],
                        meshes.vertices,
                        GivenCentres(bodies[name].skeleton.centres),
                        0.5,
                        2.0,
                    )
                )
                for name, meshes in people.items()
            ),
            np.zeros((0, 2), int),
            True,
            (("coarse start", 3.0), ("coarse round", 2.0)),
            1,
        )
        on_round(state)
        raise KeyboardInterrupt

    command = ("learn", "anna", "ben", str(folder / "carl.npz"), "--people", "-o", out)
    monkeypatch.setattr(verb, "learn_people", stopped)
    with pytest.raises(SystemExit) as stop:
        runs(capsys, *command)
    assert stop.value.code == 130 and "round 1 is saved in" in capsys.readouterr().err
    assert (tmp_path / "model.npz.partial").is_file() and not out.exists()
    monkeypatch.setattr(verb, "learn_people", learner)
    assert "an unfinished run exists" in fails(capsys, *command)
    assert "started with alpha" in fails(capsys, *command, "--resume", "--alpha", "7")
    assert "started with meshes" in fails(capsys, "learn", "anna", "ben", "--people", "-o", out, "--resume")
    printed = runs(capsys, *command, "--resume")
    state = instant_learner["resume"]
    assert state.round == 1 and state.has_given_joints and len(state.people) == 3
    for person, name in zip(state.people, SIZES, strict=True):
        np.testing.assert_array_equal(person.body.vertices, bodies[name].vertices)
        assert (person.damping, person.value, person.num_meshes) == (0.5, 2.0, 3)
    assert out.is_file() and not (tmp_path / "model.npz.partial").exists(), printed
    assert "this run is already complete" in runs(capsys, *command, "--resume")


def test_options_that_are_for_one_person_are_refused(scene, instant_learner, tmp_path, monkeypatch, capsys):
    folder, _, _ = scene
    monkeypatch.chdir(folder)
    out = tmp_path / "model.npz"
    for extra in ("--free-bones", "--correctives"):
        assert f"{extra} is for the meshes of one person" in fails(
            capsys, "learn", "anna", "ben", "--people", extra, "-o", out
        )
    assert "there is one person, anna" in fails(capsys, "learn", "anna", "--people", "-o", out)
    assert "--components is for several people" in fails(
        capsys, "learn", "anna", "--components", "3", "-o", out
    )
    assert "leaves out no mesh of any person" in fails(
        capsys, "learn", "{subject}/*.ply", "--hold-out", "9", "-o", out
    )
    body = limb()
    short = np.asarray(body.faces)[: len(body.faces) // 2]
    few = jc.MeshSequence(jnp.stack([body.vertices] * 2), short)
    jc.io.save_meshes(tmp_path / "dora.npz", few)
    message = fails(capsys, "learn", "anna", str(tmp_path / "dora.npz"), "--people", "-o", out)
    assert (
        "dora.npz: this mesh has 136 vertices and 128 triangles" in message and "jaxcap register" in message
    )
    assert not out.exists()


def test_the_gender_of_a_model_is_that_of_its_people(scene, instant_learner, tmp_path, monkeypatch, capsys):
    folder, _, _ = scene
    monkeypatch.chdir(folder)
    out, anna = tmp_path / "model_female.npz", tmp_path / "model_female-motion-anna.npz"
    runs(capsys, "learn", "anna", "ben", "--people", "-o", out)
    assert jc.io.read_amass_shape(anna)[1] == "female"


def test_a_skeleton_whose_motions_cannot_be_written_is_refused_first(
    scene, instant_learner, tmp_path, monkeypatch, capsys
):
    folder, bodies, _ = scene
    monkeypatch.chdir(folder)
    limbs = bodies["anna"].skeleton
    for parents, kinds, words in (
        ([-1, 0, -1], ["free", "ball", "free"], "2 roots, root, end"),
        ([-1, 0, 1], ["free", "ball", "free"], "joints that are translated, end"),
    ):
        skeleton = jc.make_skeleton(limbs.names, parents, kinds, limbs.centres)
        body = eqx.tree_at(lambda b: b.skeleton, bodies["anna"], skeleton)
        jc.save_body(tmp_path / "body.npz", body)
        message = fails(
            capsys,
            "learn",
            "anna",
            "ben",
            "--people",
            "--skeleton",
            tmp_path / "body.npz",
            "-o",
            tmp_path / "m.npz",
        )
        assert words in message and "AMASS" in message
    assert not instant_learner


def test_every_person_is_scored_on_held_out_meshes(scene, instant_learner, tmp_path, monkeypatch, capsys):
    folder, _, _ = scene
    monkeypatch.chdir(folder)
    printed = runs(
        capsys, "learn", "{subject}/*.ply", "--hold-out", "3", "--components", "5", "-o", tmp_path / "m.npz"
    )
    assert [len(meshes) for meshes in instant_learner["people"].values()] == [2, 2]
    assert "held out: surface" in printed and "1 coefficient explain" in printed
    assert verb.check_components(None, 2) == verb.check_components(1, 2) == []
    assert "--components is 2, and 2 people have 1 at most" in verb.check_components(2, 2)[0]
