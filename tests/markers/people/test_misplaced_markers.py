"""Markers that are not at the landmarks of their labels."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from test_fit_human import person, seen

from jaxcap.markers.human.fit_human import fit_human
from jaxcap.markers.human.misplaced_markers import find_misplaced, place_where_seen, widen_placements


def moved(subject, **shifts):
    """Move markers of a subject by metres."""
    offsets = np.array(subject.offsets)
    for label, shift in shifts.items():
        offsets[subject.labels.index(label)] += shift
    return eqx.tree_at(lambda s: s.offsets, subject, jnp.asarray(offsets, subject.offsets.dtype))


def test_only_the_worst_marker_of_a_bone_is_misplaced():
    bones, placements = np.array([0, 0, 1, 1, 2, 3]), np.array([0.01, 0.01, 0.01, 0.01, 0.05, 0.01])
    residuals = np.outer([0.05, 0.09, 0.0, 0.08, 0.1, 0.03], [0.6, 0.0, 0.8])
    # the second and the fourth are the worst of their bones, the fifth may be anywhere, and the last is less than 0.6 times the
    # largest
    assert find_misplaced(residuals, bones, placements).tolist() == [False, True, False, True, True, False]
    residuals[4] *= 0.4
    assert find_misplaced(residuals, bones, placements).tolist() == [False, True, False, True, False, False]
    assert not find_misplaced(np.zeros((6, 3)), bones, placements).any()


def test_neighbours_of_a_misplaced_marker_may_be_the_misplaced_ones():
    bones, placements = np.array([0, 0, 0, 1, 2, 2]), np.array([0.01, 0.02, 0.08, 0.01, 0.06, 0.01])
    misplaced = np.array([True, False, False, False, True, False])
    widened = widen_placements(placements, bones, misplaced)
    # a marker that may be anywhere on its bone, such as the fifth, says nothing about the others there
    np.testing.assert_allclose(widened, [0.15, 0.05, 0.08, 0.01, 0.15, 0.01])
    np.testing.assert_array_equal(widen_placements(placements, bones, np.zeros(6, bool)), placements)


def test_a_misplaced_marker_begins_where_it_is_seen():
    template = person(placing=0.0)
    foot = template.skeleton.index("LeftFoot")
    centres = template.skeleton.centres.at[foot].add(jnp.array([0.01, -0.02, 0.0]))
    longer = eqx.tree_at(lambda s: s.skeleton.centres, template, centres)
    residuals = np.tile([0.0, 0.01, 0.08], (template.num_markers, 1))
    chosen = np.array([label == "LTOE" for label in template.labels])
    placed = place_where_seen(template, longer, residuals, chosen)
    shifts = np.asarray(placed.offsets - template.offsets, float)
    # relative to the joint of its bone, which is elsewhere in the template
    np.testing.assert_allclose(shifts[chosen], [[-0.01, 0.03, 0.08]], atol=1e-6)
    assert not shifts[~chosen].any()


def test_markers_at_the_tips_of_boots_are_placed_where_they_are_seen():
    """From the landmarks of their labels they would be outliers in all frames, and turn the feet."""
    tips = {"LTOE": [0.0, 0.0, 0.09], "RTOE": [0.0, 0.0, 0.09]}
    truth = moved(person(), **tips)
    frames, _ = seen(truth)
    fit = fit_human(frames, num_frames=24)
    residuals = np.nanmedian(np.asarray(fit.residuals)[~fit.lost], axis=0)
    feet = [fit.subject.labels.index(label) for label in ("LTOE", "RTOE", "LHEE", "RHEE")]
    assert residuals[feet].max() < 0.01, residuals[feet]
    (message,) = [text for text in fit.messages if "not at the landmarks" in text]
    assert "LTOE" in message and "RTOE" in message and "HEE" not in message
    for label in tips:
        row, true = fit.subject.labels.index(label), truth.labels.index(label)
        foot = truth.skeleton.index("LeftFoot" if label == "LTOE" else "RightFoot")
        # two markers leave the rotation about the line through both free
        found, placed = (
            float(jnp.linalg.norm(one.offsets[index] - one.skeleton.centres[foot]))
            for one, index in ((fit.subject, row), (truth, true))
        )
        assert abs(found - placed) < 0.02
