"""The template of a registration: a human whose build and pose are functions of a flat vector."""

import functools
import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body, Posed, pose_body
from ..body.kinematics import Transforms
from ..body.people.anatomy import BODY_REGIONS
from ..body.people.human import human
from ..body.pose import Pose, rest_pose
from ..body.retraction import difference, retract
from ..body.skeleton import dof_layout

#: pairs of people that span the builds, as options of `human`
BUILDS = (
    ({"sex": 1.0}, {"sex": 0.0}),
    ({"weight": 1.0}, {"weight": 0.0}),
    ({"muscle": 1.0}, {"muscle": 0.0}),
    ({"height": 1.85}, {"height": 1.60}),
)
AVERAGE = {"sex": 0.5}
#: standard deviations (radians) of joints from rest, by the first match in their names
JOINT_DEVIATIONS = (
    ("Shoulder", 0.15), ("ForeArm", 0.4), ("Arm", 0.5), ("Hand", 0.25), ("UpLeg", 0.3), ("Leg", 0.25),
    ("Foot", 0.2), ("Toe", 0.1), ("Neck", 0.12), ("Head", 0.12), ("Back", 0.1), ("Spine", 0.1),
)  # fmt: skip
#: standard deviations of logarithms, and of builds; a build of one is an extreme person
LENGTH_DEVIATION, GIRTH_DEVIATION, SIZE_DEVIATION, BUILD_DEVIATION = 0.06, 0.12, 0.1, 0.7
#: step scale that damps the root, which has no prior, metres and radians
ROOT_DEVIATION = 3.0


class Template(eqx.Module):
    """The average human, its builds, and the groups of its bones."""

    body: Body
    #: changes of vertices and joint centres with each build, metres
    build_vertices: Float[Array, "K V 3"]
    build_centres: Float[Array, "K J 3"]
    #: the group of each bone; bones of a group stretch alike, such as left and right, and the whole trunk
    groups: tuple[int, ...] = eqx.field(static=True)

    @property
    def num_groups(self) -> int:
        return max(self.groups) + 1


class Build(eqx.Module):
    """A person's build, zero for the average one."""

    size: Float[Array, ""]
    components: Float[Array, "K"]
    #: logarithms of the stretch along and across the bones of a group
    lengths: Float[Array, "G"]
    girths: Float[Array, "G"]


class Person(eqx.Module):
    """A build in a pose."""

    build: Build
    pose: Pose


@functools.lru_cache(maxsize=1)
def load_template() -> Template:
    """Build the template, of 1,500 vertices: a registration samples surfaces at some centimetres."""
    average = _human_body(AVERAGE)
    pairs = [(_human_body(AVERAGE | more), _human_body(AVERAGE | less)) for more, less in BUILDS]
    groups = [_group(name) for name in average.skeleton.names]
    return Template(
        average,
        jnp.stack([0.5 * (a.vertices - b.vertices) for a, b in pairs]),
        jnp.stack([0.5 * (a.skeleton.centres - b.skeleton.centres) for a, b in pairs]),
        tuple(sorted(set(groups)).index(group) for group in groups),
    )


def _human_body(options: dict[str, float]) -> Body:
    return human(resolution="low", joints="tracking", **options)  # pyright: ignore[reportArgumentType]


def _group(name: str) -> str:
    """Return the stretch group of a bone: its other side, the whole trunk, neck or hand."""
    if name in BODY_REGIONS["trunk"]:
        return "Trunk"
    if "Thumb" in name or "Finger" in name:
        return "Hand"
    return "Neck" if name.startswith("Neck") else re.sub(r"^(Left|Right|[LR](?=Hip))", "", name)


def average_build(template: Template) -> Build:
    """Return the build of the unchanged template."""
    zeros = jnp.zeros(template.num_groups, template.body.vertices.dtype)
    return Build(zeros[0], zeros[: len(BUILDS)], zeros, zeros)


def build_body(template: Template, build: Build) -> Body:
    """Build the template's body with another build, at rest.

    First the builds are blended. Then every bone is stretched about its joint, by `girth` across and by
    `length` along it, and moves its descendants; vertices follow by their weights.
    """
    skeleton = template.body.skeleton
    size = jnp.exp(build.size)
    centres = size * (skeleton.centres + jnp.einsum("k,kja->ja", build.components, template.build_centres))
    blended = jnp.einsum("k,kva->va", build.components, template.build_vertices)
    vertices = size * (template.body.vertices + blended)
    along = _bone_directions(template)
    groups = np.array(template.groups)
    length, girth = jnp.exp(build.lengths)[groups], jnp.exp(build.girths)[groups]
    across = jnp.eye(3, dtype=along.dtype) - along[:, :, None] * along[:, None, :]
    stretch = girth[:, None, None] * across + length[:, None, None] * (jnp.eye(3, dtype=along.dtype) - across)
    parents = np.array(skeleton.parents)
    above = np.maximum(parents, 0)
    offsets = jnp.einsum("jab,jb->ja", stretch[above], centres - centres[above])
    offsets = jnp.where(parents[:, None] < 0, centres, offsets)
    moved = jnp.asarray(skeleton.descendants.T, offsets.dtype) @ offsets
    bones = Transforms(stretch, moved - jnp.einsum("jab,jb->ja", stretch, centres))
    skin = template.body.skin
    shaped = skin.deform(vertices, skeleton, rest_pose(skeleton), bones)
    skeleton = eqx.tree_at(lambda s: s.centres, skeleton, moved)
    return Body(skeleton, skin, shaped, template.body.faces)


def retract_person(template: Template, person: Person, step: Float[Array, "X"]) -> Person:
    """Move a person along a flat vector: tangent of the pose, size, builds, lengths, girths."""
    dofs, groups = template.body.skeleton.num_dofs, template.num_groups
    cuts = np.cumsum([dofs, 1, len(BUILDS), groups])
    d, size, builds, lengths, girths = jnp.split(step, cuts)
    build = person.build
    build = Build(
        build.size + size[0], build.components + builds, build.lengths + lengths, build.girths + girths
    )
    return Person(build, retract(template.body.skeleton, person.pose, d))


@eqx.filter_jit
def pose_template(template: Template, person: Person) -> Posed:
    """Pose the template with a person's build and pose."""
    return pose_body(build_body(template, person.build), person.pose)


def prior_offset(template: Template, person: Person, size: Float[Array, ""]) -> Float[Array, "X"]:
    """Compute the offset of a person from the prior's mean, with mean size `size`; zero for the free root."""
    skeleton, build = template.body.skeleton, person.build
    d = difference(skeleton, rest_pose(skeleton), person.pose)
    d = jnp.where(dof_layout(skeleton).joints == 0, 0.0, d)
    return jnp.concatenate([d, (build.size - size)[None], build.components, build.lengths, build.girths])


def prior_deviations(template: Template) -> Float[np.ndarray, "X"]:
    """Return the prior's standard deviations of the components of `retract_person` from the average build at rest."""
    skeleton = template.body.skeleton
    layout = dof_layout(skeleton)
    joints = np.array([_joint_deviation(name) for name in skeleton.names])
    pose = np.where(np.array(skeleton.parents)[layout.joints] < 0, ROOT_DEVIATION, joints[layout.joints])
    builds, groups = np.ones(len(BUILDS)), np.ones(template.num_groups)
    return np.concatenate(
        [
            pose,
            [SIZE_DEVIATION],
            BUILD_DEVIATION * builds,
            LENGTH_DEVIATION * groups,
            GIRTH_DEVIATION * groups,
        ]
    )


def _joint_deviation(name: str) -> float:
    return next((spread for part, spread in JOINT_DEVIATIONS if part in name), 0.1)


def _bone_directions(template: Template) -> Float[Array, "J 3"]:
    """Compute the x axes of the joints' local frames, which lie along the bones."""
    w, x, y, z = template.body.skeleton.orientations.T
    return jnp.stack([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)], 1)
