"""The assignments of scan points to the body, by the values of `--assignment`."""

from typing import Literal

from ...fit.correspondence.nearest_assignment import NearestOnSurface, NearestVertex
from ...fit.correspondence.soft_assignment import SoftAssignment

AssignmentName = Literal["vertices", "surface", "soft"]
#: by name
ASSIGNMENTS = {"vertices": NearestVertex(), "surface": NearestOnSurface(), "soft": SoftAssignment()}
