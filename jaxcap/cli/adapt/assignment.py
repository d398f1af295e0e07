"""The ways to match scan points with the body, by the values of `--assignment`."""

from typing import Literal

from ...adapt.task import TO_TRIANGLES
from ...fit.correspondence.find_pairs import Matching
from ...fit.correspondence.nearest_assignment import NearestOnSurface
from ...fit.correspondence.soft_assignment import SoftAssignment

AssignmentName = Literal["triangles", "vertices", "surface", "soft"]
#: by name
MATCHINGS: dict[AssignmentName, Matching] = {
    "triangles": TO_TRIANGLES,
    "vertices": Matching(),
    "surface": Matching(assignment=NearestOnSurface()),
    "soft": Matching(assignment=SoftAssignment()),
}
