"""The ways to match scan points with the body, by the values of `--assignment`."""

from typing import Literal

from ...adapt.task import TO_TRIANGLES
from ...fit.correspondence.find_pairs import Matching
from ...fit.correspondence.nearest_assignment import NearestOnSurface, NearestVertex
from ...fit.correspondence.soft_assignment import SoftAssignment

AssignmentName = Literal["triangles", "vertices", "surface", "soft"]
#: by name
MATCHINGS: dict[AssignmentName, Matching] = {
    "triangles": TO_TRIANGLES,
    "vertices": TO_TRIANGLES._replace(assignment=NearestVertex()),
    "surface": TO_TRIANGLES._replace(assignment=NearestOnSurface()),
    "soft": TO_TRIANGLES._replace(assignment=SoftAssignment()),
}
