"""Adapt a template body to the actor in a sequence of scans."""

from .compare_people import compare_people as compare_people
from .objective import CoefficientPrior as CoefficientPrior
from .objective import PoseTerms as PoseTerms
from .objective import shared_problem as shared_problem
from .objective import window_problem as window_problem
from .poses.sliding_window import smooth_poses as smooth_poses
from .registration.collect import RegisteredMeshes as RegisteredMeshes
from .registration.collect import collect_registered as collect_registered
from .registration.register_scans import RegisteredScan as RegisteredScan
from .registration.register_scans import RegisterSettings as RegisterSettings
from .registration.register_scans import register_scans as register_scans
from .shape.people_shapes import estimate_people_shapes as estimate_people_shapes
from .shape.shape_prior import ShapePrior as ShapePrior
from .shape.shape_prior import make_shape_prior as make_shape_prior
from .shape.shape_space import learn_shape_space as learn_shape_space
from .shape.shape_space import shape_space_like as shape_space_like
from .shape.shape_uncertainty import ShapeUncertainty as ShapeUncertainty
from .shape.shape_uncertainty import joint_deviations as joint_deviations
from .shape.shape_uncertainty import shape_uncertainty as shape_uncertainty
from .shape.tracked_shape import estimate_shape as estimate_shape
from .shape.tracked_shape import fit_tracked_shape as fit_tracked_shape
from .shape.vertex_adaptation import adapt_together as adapt_together
from .task import AdaptSettings as AdaptSettings
from .task import AdaptState as AdaptState
from .task import AdaptTask as AdaptTask
from .task import OtherPerson as OtherPerson
