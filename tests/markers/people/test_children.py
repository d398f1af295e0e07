"""Small people: the body at their size, a wider prior, and no percentiles of adults."""

import numpy as np
import pytest

from jaxcap.body.people.morph_targets import Traits
from jaxcap.markers.human.anatomical_prior import BONE_SHARE, CHILD_BONE_SHARE
from jaxcap.markers.human.body_size import PersonSize, body_height, is_adult, person_of_size
from jaxcap.markers.human.describe_human import describe_child
from jaxcap.markers.human.human_template import make_human_template
from jaxcap.markers.human.population import SHARES
from jaxcap.markers.human.rest_positions import limb_lengths, stretch_fields
from jaxcap.markers.marker_sets.recognise import recognise_markers

LABELS = [
    "LASI",
    "RASI",
    "LPSI",
    "RPSI",
    "LKNE",
    "RKNE",
    "LKNM",
    "RKNM",
    "LANK",
    "RANK",
    "LMED",
    "RMED",
    "LHEE",
    "RHEE",
    "LTOE",
    "RTOE",
    "C7",
    "CLAV",
    "STRN",
    "LFHD",
    "RFHD",
    "LBHD",
    "RBHD",
    "LSHO",
    "RSHO",
    "LELB",
    "RELB",
    "LWRA",
    "LWRB",
    "RWRA",
    "RWRB",
]


@pytest.mark.parametrize(("age", "stature"), [(10.0, -0.2), (35.0, 0.1)])
def test_the_size_of_a_child_is_found(age, stature):
    """From the markers of single bones, in whatever pose, to 6 cm."""
    known = recognise_markers(LABELS)
    truth = Traits(0.5, age, 0.5, 0.5, stature)
    places = np.asarray(make_human_template(known, truth).subject.offsets, float)
    found = person_of_size(known, np.linalg.norm(places[:, None] - places, axis=2)).traits
    assert abs(body_height(found) - body_height(truth)) < 0.06
    assert is_adult(found) == (age > 20)


def test_the_prior_of_a_child_is_wider_and_says_whose_it_is():
    known = recognise_markers(LABELS[:8])
    shares = [make_human_template(known, Traits(0.5, age, 0.5, 0.5, 0.0)).prior.bone_share for age in (10.0, 35.0)]  # fmt: skip
    assert shares == [CHILD_BONE_SHARE, BONE_SHARE]
    child, adult = Traits(0.5, 10.0, 0.5, 0.5, 0.0), Traits(0.5, 35.0, 0.5, 0.5, 0.0)
    lengths = np.ones(4)
    said = describe_child(PersonSize(child, lengths, 1.31, 0.04), child)
    assert len(said) == 1 and "1.31 m" in said[0] and "prior is one of adults" in said[0]
    assert describe_child(PersonSize(adult, lengths, 1.67, 0.04), adult) == []


def test_a_small_adult_is_no_child_and_may_be_one():
    """A woman of 1.49 m (one in fifty) is an adult, and the output says that she may be a child."""
    known = recognise_markers(LABELS)
    small = Traits(0.0, 35.0, 0.5, 0.5, -0.31)
    assert abs(body_height(small) - 1.49) < 0.005
    subject = make_human_template(known, small).subject
    skeleton, places = subject.skeleton, np.asarray(subject.offsets, float)
    centres = np.asarray(skeleton.centres, float)
    # limbs as adults have them
    longer = 1.49 * np.array(list(SHARES.values())) / limb_lengths(skeleton, centres) - 1
    places = places + np.tensordot(
        longer, stretch_fields(skeleton, centres, np.asarray(subject.bones), places)[0], 1
    )
    found = person_of_size(known, np.linalg.norm(places[:, None] - places, axis=2))
    assert is_adult(found.traits) and found.may_be_child and abs(found.height - 1.49) < 0.06
    (said,) = describe_child(found, found.traits)
    assert "as children and small adults are" in said and "taken for an adult" in said
