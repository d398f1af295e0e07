"""A human followed through small clouds: accuracy, loss and recovery, resuming, symmetries."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.body.body import pose_body
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose, stack_poses
from jaxcap.body.retraction import difference, retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.cli.track.frame_records import pack, row_template, unpack
from jaxcap.energy.energy import AbstractEnergy
from jaxcap.energy.priors.human_prior import human_prior
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.geometry.mesh import sample_surface
from jaxcap.observe import stack_clouds
from jaxcap.observe.clouds import Cloud, make_cloud, missing_cloud
from jaxcap.tracking import advance, judge_frame
from jaxcap.tracking.batch import fit_batch, scan_track
from jaxcap.tracking.expectation_maximisation.pose_log_density import pose_log_density
from jaxcap.tracking.judgement.verdict import NO_PERSON
from jaxcap.tracking.track import track, track_frames
from jaxcap.tracking.track_frame import make_tracker, start_state

POINTS, NOISE, FRAMES, JUNK = 600, 0.003, 6, 3
TRACES: list[int] = []


class Counted(AbstractEnergy):
    """Nothing, but notes every time that it is traced."""

    def residual(self, posed):
        TRACES.append(1)
        return 0.0 * posed.joints[0]


BODY = human(resolution="low", joints="tracking")
SKELETON = BODY.skeleton
TRACKER = make_tracker(BODY, terms=(Counted(),))
_pose_body = eqx.filter_jit(pose_body)


def motion_of(rng) -> list[Pose]:
    """The body turns, walks and swings its arms and legs, slowly."""
    layout, change = dof_layout(SKELETON), np.zeros(SKELETON.num_dofs)
    change[layout.translations[0]] = 0.015 * rng.normal(size=3)
    for name in ("Hips", "LeftArm", "RightArm", "LeftForeArm", "RightUpLeg", "RightLeg", "Neck"):
        change[layout.rotations[SKELETON.index(name)]] = 0.04 * rng.normal(size=3)
    return [
        retract(SKELETON, rest_pose(SKELETON), jnp.asarray(frame * change)) for frame in range(FRAMES + 1)
    ]


def scan(pose: Pose, rng) -> Cloud:
    points, normals = sample_surface(
        np.asarray(_pose_body(BODY, pose).vertices), np.asarray(BODY.faces), POINTS, rng
    )
    return make_cloud(points + NOISE * rng.normal(size=points.shape), normals)


def junk(rng) -> Cloud:
    points = rng.uniform([-0.8, -0.8, -0.5], [0.8, 0.9, 0.5], (POINTS, 3))
    return make_cloud(points, rng.normal(size=points.shape))


def joint_error(a: Pose, b: Pose) -> float:
    """Mean distance of joint centres, metres."""
    apart = _pose_body(BODY, a).joints - _pose_body(BODY, b).joints
    return float(jnp.mean(jnp.linalg.norm(apart, axis=1)))


def same(a, b) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


def apart(a: Pose, b: Pose) -> float:
    return float(jnp.abs(difference(SKELETON, a, b)).max())


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(11)
    truth = motion_of(rng)
    return truth, [scan(pose, rng) for pose in truth]


@pytest.fixture(scope="module")
def tracked(scene):
    """The sequence with a frame of junk in it, and how often the energy was traced by each frame."""
    truth, clouds = scene
    clouds = [*clouds[:JUNK], junk(np.random.default_rng(1)), *clouds[JUNK + 1 :]]
    frames, traces = [], []
    for frame in track_frames(TRACKER, clouds, truth[0], sigma=0.05):
        frames.append(frame)
        traces.append(len(TRACES))
    return frames, traces, clouds


def test_a_human_is_followed_within_a_centimetre(scene, tracked):
    frames, _, _ = tracked
    for number, (frame, truth) in enumerate(zip(frames[:JUNK], scene[0][:JUNK], strict=True)):
        assert not frame.lost, number
        assert joint_error(frame.pose, truth) < 0.008, number
        # noise of 3 mm, and the distance from any point to a vertex of triangles some 4 cm wide
        assert float(frame.statistics.sigma) < 0.02
        assert float(frame.statistics.outlier_share) < 0.1


def test_junk_is_lost_and_the_body_is_found_again(scene, tracked):
    frames, _, _ = tracked
    assert [frame.lost for frame in frames] == [number == JUNK for number in range(FRAMES + 1)]
    errors = [joint_error(frame.pose, truth) for frame, truth in zip(frames, scene[0], strict=True)]
    assert max(errors[JUNK + 1 :]) < 0.012, errors


def test_frames_are_traced_once(tracked):
    _, traces, _ = tracked
    assert traces[0] > 0
    assert traces[JUNK - 1] == traces[0]
    # the search after junk is a function of its own, the frames after it are not
    assert traces[-1] == traces[JUNK]


def test_frames_that_are_tracked_ahead_are_the_same(tracked):
    """A list shows the next cloud, which is tracked from a state that a lost frame changes; an iterator does not."""
    frames, _, clouds = tracked
    one_by_one = list(
        track_frames(TRACKER, iter(clouds), motion_of(np.random.default_rng(11))[0], sigma=0.05)
    )
    assert same([frame.state for frame in frames], [frame.state for frame in one_by_one])
    assert [frame.verdict for frame in frames] == [frame.verdict for frame in one_by_one]


def test_an_error_of_the_next_cloud_comes_at_its_turn(tracked):
    frames, _, clouds = tracked
    wrong = eqx.tree_at(lambda cloud: cloud.points, clouds[1], 1000.0 * clouds[1].points)

    def read():
        yield from clouds[:2]
        raise InputError("This file is damaged.")

    stream = track_frames(TRACKER, read(), frames[0].pose, sigma=0.05, look_ahead=True)
    assert [next(stream).lost, next(stream).lost] == [False, False]
    with pytest.raises(InputError, match="damaged"):
        next(stream)
    stream = track_frames(TRACKER, [clouds[0], wrong], frames[0].pose, sigma=0.05)
    assert not next(stream).lost
    with pytest.raises(InputError, match="cloud 1 is"):
        next(stream)


def test_a_run_goes_on_from_a_frame_bit_by_bit(tracked):
    frames, _, clouds = tracked
    rest = track_frames(TRACKER, clouds[JUNK:], frames[JUNK - 1], first=JUNK)
    for again, frame in zip(rest, frames[JUNK:], strict=True):
        assert same(again, frame)


def test_frames_without_a_person_are_lost_keep_the_pose_and_resume_bit_by_bit(scene):
    """A person who comes in the second frame and is away in the fifth."""
    truth, clouds = scene
    away = missing_cloud("nobody is there.")
    seen = [away, *clouds[:3], away, clouds[3]]
    frames = list(track_frames(TRACKER, seen, truth[0], sigma=0.05))
    assert [frame.verdict for frame in frames] == ["lost", "good", "good", "good", "lost", "good"]
    for number, kept in ((0, truth[0]), (4, frames[3].pose)):
        assert frames[number].reasons == (NO_PERSON,)
        assert frames[number].unseen == ()
        assert same(frames[number].pose, kept)
    # the frames that come after nobody are those of a sequence that begins with them
    alone = track_frames(TRACKER, clouds[:3], truth[0], sigma=0.05)
    assert all(same(one.pose, frame.pose) for one, frame in zip(alone, frames[1:4], strict=True))
    template = row_template(TRACKER)
    for done in (1, 5):
        stopped, _ = unpack(template, pack(frames[done - 1], 0.1))
        assert stopped.reasons == frames[done - 1].reasons
        rest = track_frames(TRACKER, seen[done:], stopped, first=done, sigma=0.05)
        for again, frame in zip(rest, frames[done:], strict=True):
            assert all(
                np.array_equal(a, b, equal_nan=True)
                for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(frame), strict=True)
            )
    with pytest.raises(InputError, match="nobody is there"):
        stack_clouds([clouds[0], away])


def test_a_scan_is_the_loop(scene):
    truth, clouds = scene
    state = start_state(TRACKER, truth[0])
    stacked = stack_clouds(clouds[:3])
    last, (poses, statistics) = eqx.filter_jit(scan_track)(TRACKER, state, stacked)
    for number in range(3):
        state, alone = judge_frame.track_frame_jit(TRACKER, state, clouds[number])
        pose = jax.tree.map(lambda leaf, number=number: leaf[number], poses)
        assert apart(pose, state.estimate.pose) < 1e-8
        assert float(statistics.log_likelihood[number]) == pytest.approx(
            float(alone.log_likelihood), rel=1e-9
        )
    np.testing.assert_allclose(last.change, state.change, atol=1e-8)


def test_a_fast_motion_takes_more_steps(scene):
    """A prediction from six frames before; after one of a single frame the steps are the same."""
    truth, clouds = scene
    few = make_tracker(BODY, terms=(Counted(),), max_iterations=TRACKER.iterations)
    state = start_state(TRACKER, truth[0], 0.02)

    def followed(tracker, number):
        return judge_frame.track_frame_jit(tracker, state, clouds[number])[0].estimate.pose

    near, far = ([followed(tracker, number) for tracker in (few, TRACKER)] for number in (1, FRAMES))
    assert apart(*near) < 1e-9
    errors = [joint_error(pose, truth[FRAMES]) for pose in far]
    assert errors[1] < 0.5 * errors[0]


def test_the_last_step_leaves_out_the_points_of_the_step_before_it(rng):
    """Each of four subsets has every fourth point. Three steps use one subset each, and the last step uses all but the third subset."""
    pose = rest_pose(SKELETON)
    points, normals = sample_surface(np.asarray(BODY.vertices), np.asarray(BODY.faces), 5120, rng)
    cloud = make_cloud(points, normals)
    shares = []
    for subset in (2, 3):
        moved = eqx.tree_at(lambda c: c.points, cloud, cloud.points.at[subset::4, 0].add(3.0))
        _, statistics = judge_frame.track_frame_jit(TRACKER, start_state(TRACKER, pose, 0.01), moved)
        shares.append(float(statistics.outlier_share))
    assert shares[0] < 0.05
    assert shares[1] == pytest.approx(1 / 3, abs=0.05)


def test_a_batch_is_its_members(scene):
    """Also side by side, where one member needs more steps than the other."""
    truth, clouds = scene
    starts = stack_poses([truth[1], truth[0]]).poses
    for size in (None, 2):
        poses, statistics = fit_batch(
            TRACKER, starts, stack_clouds([clouds[1], clouds[FRAMES]]), sigma=0.02, batch_size=size
        )
        for number, (start, frame) in enumerate(((1, 1), (0, FRAMES))):
            state = start_state(TRACKER, truth[start], 0.02)
            state, alone = judge_frame.track_frame_jit(TRACKER, state, clouds[frame])
            pose = jax.tree.map(lambda leaf, number=number: leaf[number], poses)
            assert apart(pose, state.estimate.pose) < 1e-8
            assert float(statistics.sigma[number]) == pytest.approx(float(alone.sigma), rel=1e-8)


def test_the_order_of_points_does_not_matter(scene, rng):
    truth, clouds = scene
    state = start_state(TRACKER, truth[0])
    order = rng.permutation(clouds[1].points.shape[0])
    shuffled = jax.tree.map(lambda leaf: leaf[order], clouds[1])
    one, other = (judge_frame.track_frame_jit(TRACKER, state, cloud)[0] for cloud in (clouds[1], shuffled))
    assert apart(one.estimate.pose, truth[0]) > 0.01
    assert apart(one.estimate.pose, other.estimate.pose) < 1e-6


def test_a_rigid_motion_of_cloud_and_start_moves_the_result_alike(scene):
    """By a third of a turn about (1, 1, 1), under which the scene's box stays a box."""
    truth, clouds = scene
    turn = rotation.about_axis(jnp.ones(3) / np.sqrt(3), jnp.asarray(2 * np.pi / 3))
    shift, centre = jnp.asarray([0.3, -1.0, 2.0]), SKELETON.centres[0]

    def turned(x):
        return jax.vmap(lambda row: rotation.rotate(turn, row))(x)

    def moved(pose: Pose) -> Pose:
        place = rotation.rotate(turn, centre + pose.translations[0]) + shift - centre
        return Pose(
            pose.translations.at[0].set(place),
            pose.rotations.at[0].set(rotation.multiply(turn, pose.rotations[0])),
            pose.scale,
        )

    cloud = clouds[2]
    there = Cloud(turned(cloud.points) + shift, turned(cloud.normals), cloud.weights)
    np.testing.assert_allclose(
        _pose_body(BODY, moved(truth[2])).vertices,
        turned(_pose_body(BODY, truth[2]).vertices) + shift,
        atol=1e-12,
    )
    here, _ = judge_frame.track_frame_jit(TRACKER, start_state(TRACKER, truth[1]), cloud)
    far, _ = judge_frame.track_frame_jit(TRACKER, start_state(TRACKER, moved(truth[1])), there)
    assert apart(far.estimate.pose, moved(here.estimate.pose)) < 1e-6


def test_a_motion_and_a_warning_come_from_track(scene, tracked):
    truth, _ = scene
    clouds = tracked[2]
    with pytest.warns(UserWarning, match=f"1 of {JUNK + 1} frames are lost: {JUNK}"):
        motion = track(BODY, clouds[: JUNK + 1], truth[0], rate=25.0, tracker=TRACKER)
    assert motion.rate == 25.0
    assert motion.num_frames == JUNK + 1
    assert joint_error(motion[1], truth[1]) < 0.008
    with pytest.raises(InputError, match=r"cloud 0 .*millimetres"):
        track(BODY, [eqx.tree_at(lambda c: c.points, clouds[0], 1000.0 * clouds[0].points)])


def test_the_first_pose_is_searched_for_where_the_start_explains_nothing(scene, monkeypatch):
    truth, clouds = scene
    searched, announced = [], []

    def found(tracker, cloud, **options):
        searched.append(cloud)
        return truth[0], None

    monkeypatch.setattr(advance, "initialise", found)
    layout = dof_layout(SKELETON)
    raised = np.zeros(SKELETON.num_dofs)
    raised[layout.translations[0]] = [0.6, 0.3, 0.0]
    away = retract(SKELETON, truth[0], jnp.asarray(raised))

    def first(start, search):
        frames = track_frames(
            TRACKER, clouds[:1], start, search=search, sigma=0.02, on_search=announced.append
        )
        return next(frames)

    assert first(truth[0], "auto").verdict == "good"
    assert first(away, False).verdict != "good"
    assert not searched and not announced
    frame = first(away, "auto")
    assert (len(searched), frame.verdict, frame.searches.count) == (1, "good", 1.0)
    assert joint_error(frame.pose, truth[0]) < 0.012
    assert first(truth[0], True).verdict == "good"
    assert len(searched) == 2
    assert announced[0].frame == 0 and announced[0].reasons
    assert announced[1].reasons == ()


@pytest.mark.parametrize(
    ("densities", "bad", "count", "best"),
    [
        # as in real depth images of a person from behind: the first search ends back to front, and explains the image
        ((5.232, 5.319, 5.319), (), 3, 1),
        ((5.061, 5.056, 5.255, 5.224, 5.354), (0, 1), 5, 4),
        ((5.329, 5.329), (), 2, 0),
    ],
)
def test_searches_of_a_partly_seen_person_end_where_two_agree(
    tracked, monkeypatch, densities, bad, count, best
):
    frame, cloud, searched = tracked[0][1], tracked[2][1], []
    assert frame.verdict == "good"

    def found(tracker, cloud, *, key, **options):
        searched.append(int(jax.random.key_data(key)[-1]))
        return numbered(len(searched) - 1).pose, None

    def numbered(number):
        moved = frame.pose.translations.at[0, 0].set(float(number))
        judged = eqx.tree_at(lambda f: f.pose.translations, frame, moved)
        return eqx.tree_at(lambda f: f.lost, judged, number in bad)

    def density(tracker, pose, cloud):
        return jnp.asarray(densities[int(pose.translations[0, 0]) % len(densities)])

    for name, fake in (
        ("initialise", found),
        (
            "track_first_frame",
            lambda tracker, surface, cloud, pose, *rest: numbered(int(pose.translations[0, 0])),
        ),
        ("pose_log_density", density),
        ("choose_better", lambda t, c, new, old: max(old, new, key=lambda f: float(density(t, f.pose, c)))),
    ):
        monkeypatch.setattr(advance, name, fake)
    follower = advance.make_follower(
        eqx.tree_at(lambda t: t.pose_prior, TRACKER, human_prior(SKELETON), is_leaf=lambda x: x is None)
    )
    chosen = advance.search_first_frame(follower, TRACKER, None, cloud)
    assert (searched, int(chosen.pose.translations[0, 0])) == (list(range(count)), best)
    # a person who is seen whole is searched for until a pose is good
    advance.search_first_frame(advance.make_follower(TRACKER), TRACKER, None, cloud)
    assert len(searched) == count + 1
    # if none is good, the first search counts
    bad = range(count + 1, 99)
    chosen = advance.search_first_frame(advance.make_follower(TRACKER), TRACKER, None, cloud)
    assert len(searched) == count + 1 + advance.WHOLE_SEARCHES
    assert int(chosen.pose.translations[0, 0]) == count + 1


def test_searches_that_do_not_help_become_rare():
    patience, waits = judge_frame.SearchHistory(), []
    for _ in range(8):
        patience = patience.extend()
        waits.append(patience.wait)
        while patience.wait > 0:
            patience = patience.advance(good=False)
    assert waits == [2, 4, 8, 16, 32, 64, 128, 128]
    for _ in range(7):
        patience = patience.advance(good=True)
    assert patience.extend().wait == 2


class Below(AbstractEnergy):
    """Joints above a height, in standard deviations of 5 mm."""

    def residual(self, posed):
        return jnp.maximum(posed.joints[:, 1] - 0.5, 0.0) / 0.005


def test_poses_are_compared_with_a_users_terms(rng):
    pose = rest_pose(SKELETON)
    cloud = scan(pose, rng)
    plain, bounded = (make_tracker(BODY, terms=terms) for terms in ((), (Below(),)))
    r = Below().residual(_pose_body(BODY, pose))
    loss = pose_log_density(plain, pose, cloud) - pose_log_density(bounded, pose, cloud)
    assert float(loss) == pytest.approx(0.5 * float(r @ r) / POINTS, rel=1e-4)
    assert float(loss) > 0.1


class HeightRoot(AbstractEnergy):
    """A square root that is NaN below half a metre."""

    def residual(self, posed):
        return jnp.sqrt(posed.vertices[:, 1] - 0.5)


def test_terms_that_are_not_finite_and_traced_points_are_sentences(rng):
    pose = rest_pose(SKELETON)
    cloud = scan(pose, rng)
    with pytest.raises(InputError, match="the residual of HeightRoot is not finite in"):
        track(BODY, [cloud], pose, terms=[HeightRoot()])
    with pytest.raises(InputError, match="make_cloud: `points` is traced by jit, grad or vmap"):
        jax.grad(lambda points: make_cloud(points).points.sum())(cloud.points)
