"""Preparation of an adaptation task from a template and its scans."""

from collections.abc import Callable, Sequence

import jax.numpy as jnp

from ..arguments import checked
from ..body.body import Body, body_height
from ..body.body_model import BodyModel
from ..body.people.anatomy import rest_deviations
from ..body.pose import Pose
from ..body.symmetry import find_left_right_pairs
from ..energy.check_energies import UserTerms, sum_user_terms
from ..energy.energy import AbstractEnergy
from ..energy.priors.reference_pose import RestPrior
from ..errors import InputError
from ..fit.correspondence.nearest_assignment import IndexedScan
from ..geometry.camera import Camera
from ..limits.rotation_vector_boxes import PoseBoxes
from ..observe.clouds import Cloud, CloudFrames
from ..observe.floors_and_walls import find_room, remove_planes
from ..observe.planes import Plane
from .poses.similarity import is_unordered
from .shape.shape_prior import ShapePrior
from .shape.shape_space import shape_space_like
from .task import AdaptSettings, AdaptTask, check_settings


@checked
def make_adapt_task(
    template: Body,
    clouds: Cloud | Sequence,
    rate: float = 30.0,
    *,
    start: Pose | None = None,
    pose_prior: AbstractEnergy | None = None,
    settings: AdaptSettings = AdaptSettings(),
    cameras: Sequence[Camera] = (),
    missing: Sequence[int] = (),
    boxes: PoseBoxes | None = None,
    shape_prior: ShapePrior | None = None,
    mesh: Callable[[int], IndexedScan] | None = None,
    terms: UserTerms = (),
    full_body: Body | None = None,
    model: BodyModel | None = None,
    planes: Sequence[Plane] | None = None,
) -> AdaptTask:
    """Make the task of `adapt_body`.

    Poses have an anatomical prior around rest, and left bones are as long as right ones. If the template is a
    human, of any triangulation, its proportions are estimated in a shape space of people, and with a body model by its
    coefficients.

    **Arguments:** `clouds`, a `Cloud` for each frame, metres, loaded on demand, or the result of
    `read_clouds`; `rate`, frames per second; `start`, a pose near that of the first frame, searched for if
    None; `pose_prior`, a further pose prior, such as `MahalanobisPrior(learn_pair_prior(...))`; `terms`, further
    energies of every frame's posed body in units of a log-likelihood, such as `make_floor(template)`, which
    act in all stages; `full_body`, the body that the template was reduced from; `model`, the body model that the template belongs to; `planes`, floors and walls
    whose points are removed: by default those of the first cloud (`jc.observe.find_room`); the others as in `AdaptTask`. The
    order of the scans in time is detected from some of them, unless `settings.unordered` is given.

    **Raises:** `InputError` if no frame has a cloud, a setting is out of its range, or `settings` are
    incompatible with unordered scans.
    """
    check_settings(settings)
    clouds = CloudFrames(clouds)
    if len(clouds) <= len(set(missing)):
        raise InputError(
            f"There are {len(clouds)} frames, and {len(set(missing))} are missing; expected at least one cloud."
        )
    skeleton = template.skeleton
    prior: AbstractEnergy = RestPrior(jnp.asarray(rest_deviations(skeleton, 1.0), template.vertices.dtype))
    missing = tuple(missing)
    scanned = sorted(set(range(len(clouds))) - set(missing))
    removed = find_room(clouds[scanned[0]]) if planes is None else planes

    def cloud(frame: int) -> Cloud:
        return remove_planes(clouds[frame], removed)

    if settings.unordered is None:
        settings = settings._replace(unordered=is_unordered(cloud, scanned, float(body_height(template))))
    if settings.unordered and (settings.every or settings.temporal_weight):
        raise InputError(
            "The scans are not ordered in time, as adaptation during tracking and a weight of smooth motion require; "
            "leave these out (every, temporal_weight; --adapt-every, --smoothness), or give unordered=False or --ordered "
            "if the scans are ordered."
        )
    return AdaptTask(
        template=template,
        cloud=cloud,
        num_frames=len(clouds),
        rate=rate,
        start=start,
        prior=prior if pose_prior is None else prior + pose_prior,
        left_right_pairs=find_left_right_pairs(skeleton),
        settings=settings,
        shape_space=shape_space_like(template, full_body) if model is None else model,
        cameras=tuple(cameras),
        missing=missing,
        boxes=boxes,
        shape_prior=shape_prior,
        mesh=mesh,
        terms=sum_user_terms("adapt_body", terms, template),
    )
