"""What an adaptation has brought: summaries against SciPy, variants against what they are made of, and the page."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from command_line import fails, runs
from helpers import chain_body

import jaxcap as jc
from jaxcap.adapt.evaluate import (
    BIN_WIDTH,
    Evaluation,
    add_distances,
    compare_stages,
    empty_histogram,
    main_axes,
    quantile,
    share_below,
    summarise,
    variant_names,
)
from jaxcap.adapt.objective import Terms
from jaxcap.adapt.task import AdaptSettings, AdaptState, AdaptTask, OtherPerson, plan_stages
from jaxcap.body.body import scale_body
from jaxcap.body.pose import rest_pose, stack_poses
from jaxcap.body.retraction import retract
from jaxcap.body.symmetry import find_left_right_pairs
from jaxcap.cli.adapt.adapt import Adapt
from jaxcap.cli.adapt.input import check_input
from jaxcap.cli.adapt.state import fingerprint_of, make_checkpoint
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.geometry.mesh import sample_surface
from jaxcap.io.archives.checkpoint import save_checkpoint
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.metrics import scan_to_surface
from jaxcap.report.adaptation import adaptation_page, others_table, report_adaptation
from jaxcap.report.chart import svg_path, ticks
from jaxcap.report.page import VOID, element, page, table

FRAMES, RATE = 5, 10.0
_pose_body = eqx.filter_jit(jc.pose_body)


def test_summaries_against_scipy(rng):
    values = rng.exponential(0.004, 30_000)
    known = empty_histogram()
    for part in np.split(values, [100, 9_000]):
        known = add_distances(known, np.append(part, np.nan))
    summary = summarise(known)
    assert summary.count == len(values)
    assert summary.mean == pytest.approx(values.mean())
    assert summary.sd == pytest.approx(values.std())
    assert summary.median == pytest.approx(np.median(values), abs=BIN_WIDTH)
    assert summary.mad == pytest.approx(scipy.stats.median_abs_deviation(values), abs=BIN_WIDTH)
    assert summary.iqr == pytest.approx(scipy.stats.iqr(values), abs=2 * BIN_WIDTH)
    assert quantile(known, 0.9) == pytest.approx(np.quantile(values, 0.9), abs=BIN_WIDTH)
    limits = np.array([0.0, 0.001, 0.02])
    found = [np.mean(values < limit) for limit in limits]
    np.testing.assert_allclose(share_below(known, limits), found, atol=1e-3)


def test_far_distances_count_and_none_are_told_as_such():
    far = add_distances(empty_histogram(), np.array([0.001, 30.0, np.inf]))
    assert summarise(far).count == 2
    assert summarise(far).mean == pytest.approx(15.0005)
    none = summarise(empty_histogram())
    assert none.count == 0
    assert np.isnan(none[:5]).all()


def test_the_axis_of_a_joint_is_the_one_it_turns_about_most(rng):
    axis = np.array([0.6, -0.8, 0.0])
    vectors = rng.uniform(-1, 1, (50, 1))[..., None] * axis + 0.01 * rng.normal(size=(50, 1, 3))
    np.testing.assert_allclose(main_axes(vectors), [-axis], atol=0.02)


@pytest.fixture(scope="module")
def scene():
    """A finished adaptation of a small body: the actor is larger and has bumps, the state is nearly the truth."""
    rng, template = np.random.default_rng(5), chain_body("linear", 10, 8)
    # two bones that are about as long as each other
    sides = {"elbow": "LeftBone", "hand": "RightBone"}
    names = tuple(sides.get(name, name) for name in template.skeleton.names)
    template = replace(template, skeleton=replace(template.skeleton, names=names))
    actor = scale_body(template, jnp.asarray(1.1))
    bumps = 0.003 * rng.normal(size=actor.vertices.shape)
    actor = eqx.tree_at(lambda body: body.vertices, actor, actor.vertices + bumps)
    still, way = rest_pose(actor.skeleton), 0.2 * rng.normal(size=actor.skeleton.num_dofs)
    poses = [retract(actor.skeleton, still, jnp.asarray(0.1 * n * way)) for n in range(FRAMES)]
    clouds = []
    for pose in poses:
        vertices = np.asarray(_pose_body(actor, pose).vertices, float)
        points, normals = sample_surface(vertices, np.asarray(actor.faces), 700, rng)
        clouds.append(jc.make_cloud(points + 0.0005 * rng.normal(size=points.shape), normals))
    prior = RestPrior(jnp.full((template.skeleton.num_joints, 3), 0.7))
    settings = AdaptSettings(num_frames=2, proportion_rounds=1, rounds=(1, 1))
    task = AdaptTask(
        template,
        clouds.__getitem__,
        FRAMES,
        RATE,
        None,
        prior,
        find_left_right_pairs(template.skeleton),
        settings,
    )
    shaken = [retract(actor.skeleton, p, jnp.asarray(0.002 * rng.normal(size=len(way)))) for p in poses]
    done, told = len(plan_stages(settings)), (("size", 4.0), ("smooth", 1.0))
    terms = (Terms(1.6e-5, 2.0, 1e-5, 0.0, 0.0), Terms(1e-6, 3.0, 1e-6, 4e-6, 1e-8))
    motion = stack_poses(shaken, RATE)
    return task, AdaptState(done, actor, 1.1, motion, (3,), (0, 4), told, pose_weight=1e-6, terms=terms)


@pytest.fixture(scope="module")
def stages(scene) -> Evaluation:
    every = list(compare_stages(*scene))
    assert [len(one.variants) for one in every] == [1, 2, 3, 4]
    return every[-1]


def test_variants_come_nearer_to_the_scans(scene, stages):
    task, state = scene
    assert [variant.name for variant in stages.variants] == variant_names(task.settings)
    assert stages.measured_frames == tuple(range(FRAMES))
    medians = [summarise(variant.scan_to_body).median for variant in stages.variants]
    assert medians[0] > medians[1] > medians[2]
    np.testing.assert_allclose(stages.variants[0].body.vertices, 1.1 * task.template.vertices)
    assert stages.variants[3].body is state.body
    assert stages.variants[3].lost == (3,)


def test_the_last_variant_is_the_final_motion(scene, stages):
    task, state = scene
    faces, apart, back = np.asarray(state.body.faces), [], []
    for frame in range(FRAMES):
        points = np.asarray(task.cloud(frame).points)[np.asarray(task.cloud(frame).weights) > 0]
        vertices = np.asarray(_pose_body(state.body, state.motion[frame]).vertices, float)
        apart.append(scan_to_surface(points, vertices, faces))
        back.append(np.linalg.norm(vertices[:, None] - points, axis=-1).min(1))
    last = stages.variants[-1]
    assert summarise(last.scan_to_body).mean == pytest.approx(np.mean(apart))
    assert summarise(last.body_to_scan).mean == pytest.approx(np.mean(back))
    np.testing.assert_allclose(last.frame_medians, np.median(apart, axis=1))
    assert np.isfinite(last.heat).any()
    assert np.nanmax(last.heat) <= np.max(apart)


def test_joints_shake_less_where_a_motion_is_even(scene, stages):
    _, state = scene
    angles = stages.angles
    assert angles is not None
    assert angles.after is not None
    assert angles.before.shape == angles.after.shape == (FRAMES, state.body.skeleton.num_joints)
    np.testing.assert_allclose(angles.seconds, np.arange(FRAMES) / RATE)
    assert angles.roughness_after is not None
    # a fixed joint does not turn, and others by their even way alone but for what they were shaken by
    fixed = [kind in ("fixed", "translate") for kind in state.body.skeleton.kinds]
    assert np.abs(angles.roughness_after[fixed]).max() < 1e-6
    assert angles.roughness_after.max() < 0.01


def test_some_frames_and_no_smooth_motion(scene):
    task, state = scene
    task = task._replace(settings=task.settings._replace(temporal_weight=0.0))
    last = list(compare_stages(task, state, step=2))[-1]
    assert [variant.name for variant in last.variants] == ["not adapted", "first frame", "many frames"]
    assert last.measured_frames == (0, 2, 4)
    assert last.angles is not None
    assert last.angles.after is None
    apart = summarise(last.variants[-1].scan_to_body)
    assert apart.count == 3 * 700
    assert "smoothed motion" not in adaptation_page(task, state, last, {})


def test_meshes_are_met_in_their_own_frames(scene):
    task, state = scene
    task = task._replace(settings=task.settings._replace(temporal_weight=0.0))
    clouds, meshes = (
        list(compare_stages(one, state, step=2))[-1] for one in (task, task._replace(mesh=task.scan))
    )
    for cloud, mesh in zip(clouds.variants, meshes.variants, strict=True):
        np.testing.assert_array_equal(cloud.scan_to_body.counts, mesh.scan_to_body.counts)


def test_what_cannot_be_measured(scene):
    task, state = scene
    with pytest.raises(ValueError, match="finish the adaptation"):
        next(compare_stages(task, state._replace(done=2)))
    with pytest.raises(ValueError, match="at least 1"):
        next(compare_stages(task, state, step=0))


class Parsed(HTMLParser):
    """A page as it is nested; every element that is opened has to be closed, in turn."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append((self.open[-1] if self.open else "", data))

    def attributes(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def told(scene, stages) -> str:
    return adaptation_page(*scene, stages, {"template": "<b>ann & bob</b>.npz", "prior": None})


def test_the_page_is_whole_and_says_what_pictures_show(told):
    parsed = Parsed(told)
    pictures = parsed.attributes("img")
    assert len(pictures) == 4
    assert all((one["src"] or "").startswith("data:image/png;base64,") for one in pictures)
    assert all("mm on average" in (one["alt"] or "") for one in pictures)
    charts = [one for one in parsed.attributes("svg") if one.get("role") == "img"]
    # two of distances, one of frames, six joints, one of stages
    assert len(charts) == 10
    assert all(one["aria-label"] for one in charts)
    assert all(one.get("aria-hidden") == "true" for one in parsed.attributes("svg") if one not in charts)
    assert {one["scope"] for one in parsed.attributes("th")} == {"col", "row"}
    assert "nan" not in " ".join(text for tag, text in parsed.texts if tag != "style").lower()


def test_nothing_is_fetched(told):
    without = re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", told)
    for word in ("http:", "https:", "//", "url(", "@import", "<script", "<link", "srcset"):
        assert word not in without


def test_the_table_has_the_figures_of_the_result(told, stages):
    first = Parsed(told[: told.index("</table>") + 8].rsplit("<table", 1)[-1].join(["<table", ""]))
    cells = [text for tag, text in first.texts if tag in ("td", "th")]
    rows = [cells[9 * n : 9 * n + 9] for n in range(1, 5)]
    for row, variant in zip(rows, stages.variants, strict=True):
        summary = summarise(variant.scan_to_body)
        values = [*summary[:5], quantile(variant.scan_to_body, 0.9), quantile(variant.body_to_scan, 0.5)]
        assert row == [variant.name, *(f"{1000 * x:.2f}" for x in values), str(len(variant.lost))]


def test_names_of_files_are_text(told):
    assert "&lt;b&gt;ann &amp; bob&lt;/b&gt;.npz" in told
    assert "<b>ann" not in told
    assert element("p", "<i>", element("b", "&"), title='"') == '<p title="&quot;">&lt;i&gt;<b>&amp;</b></p>'
    Parsed(page("<title>", table("<t>", ["<a>"], [["<b>"]])))


def test_charts_have_round_ticks_and_lines_that_break():
    assert ticks(0.0, 20.0) == [0.0, 5.0, 10.0, 15.0, 20.0]
    assert ticks(-0.31, 0.1) == pytest.approx([-0.3, -0.2, -0.1, 0.0, 0.1])
    assert svg_path(np.arange(4.0), np.array([1.0, 2.0, np.nan, 4.0])) == "M0.0 1.0 L1.0 2.0 M3.0 4.0"


def test_a_report_that_cannot_be_written(scene, stages, tmp_path):
    with pytest.raises(jc.InputError, match="cannot be written"):
        report_adaptation(tmp_path / "none" / "a.html", *scene, stages, {})


def test_the_command_line_goes_on_to_the_report(scene, tmp_path, capsys):
    """A run whose stages are all done is resumed: only the report is left to make."""
    task, state = scene
    points = np.stack([np.asarray(task.cloud(n).points)[:700] for n in range(FRAMES)])
    normals = np.stack([np.asarray(task.cloud(n).normals)[:700] for n in range(FRAMES)])
    np.savez(tmp_path / "scans.npz", points=points, normals=normals)
    jc.save_body(tmp_path / "template.npz", task.template)
    out, report = tmp_path / "actor.npz", tmp_path / "<b>.html"
    verb = Adapt(str(tmp_path / "template.npz"), (str(tmp_path / "scans.npz"),), out, smoothness=0.0)
    digests = check_input(read_clouds(verb.clouds), task.template).digests
    header = {**verb.settings(), "prior": None, **fingerprint_of(task.template, digests)}
    stages = len(plan_stages(AdaptSettings(temporal_weight=0.0)))
    save_checkpoint(verb.checkpoint_path, make_checkpoint(state._replace(done=stages)), header)
    words = ("adapt", verb.body, *verb.clouds, "-o", out, "--smoothness", 0, "--report", report)
    assert f"{report}: the report" in runs(capsys, *words, "--report-every", 4, "--resume")
    assert not verb.checkpoint_path.exists()
    text = report.read_text(encoding="utf-8")
    Parsed(text)
    assert "2 of 5 frames were measured" in text


def test_what_is_refused(tmp_path, capsys):
    np.savez(tmp_path / "scans.npz", points=np.random.default_rng(0).normal(size=(4, 900, 3)))
    words = ("adapt", "human:low", tmp_path / "scans.npz", "-o", tmp_path / "a.npz", "--report")
    assert "ends in .html" in fails(capsys, *words, tmp_path / "a.txt")
    assert "--report-every is 0" in fails(capsys, *words, tmp_path / "a.html", "--report-every", 0)
    (tmp_path / "there.html").write_text("")
    assert "already exists" in fails(capsys, *words, tmp_path / "there.html")


def test_scans_of_other_people_are_listed():
    body = chain_body("linear", 4, 3)
    motion = stack_poses([rest_pose(body.skeleton)] * 4, 30.0)
    other = OtherPerson((1, 3), (("pelvis", -0.0128), ("chest", 0.002)), 4)
    shown = str(others_table(AdaptState(1, body, 1.0, motion, others=(other,))))
    assert "1, 3" in shown and "-12.8 mm at the pelvis, +2.0 mm at the chest" in shown
