"""Small people: the body at their size, a wider prior, and no percentiles of adults."""

import numpy as np
import pytest

from jaxcap.body.people.morph_targets import Traits
from jaxcap.markers.human.anatomical_prior import BONE_SHARE, CHILD_BONE_SHARE
from jaxcap.markers.human.describe_human import describe_child
from jaxcap.markers.human.human_template import body_height, is_adult, make_human_template, person_of_size
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
    found = person_of_size(known, np.linalg.norm(places[:, None] - places, axis=2))
    assert abs(body_height(found) - body_height(truth)) < 0.06
    assert is_adult(found) == (age > 20)


def test_the_prior_of_a_child_is_wider_and_says_whose_it_is():
    known = recognise_markers(LABELS[:8])
    shares = [make_human_template(known, Traits(0.5, age, 0.5, 0.5, 0.0)).prior.bone_share for age in (10.0, 35.0)]  # fmt: skip
    assert shares == [CHILD_BONE_SHARE, BONE_SHARE]
    said = describe_child(Traits(0.5, 10.0, 0.5, 0.5, 0.0))
    assert len(said) == 1 and "1.31 m" in said[0] and "prior is one of adults" in said[0]
    assert describe_child(Traits(0.5, 35.0, 0.5, 0.5, 0.0)) == []
