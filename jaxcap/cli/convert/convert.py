"""`jaxcap convert`: the same content in another format."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ...biomechanics.angles import joint_angles
from ...body.body import Body
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError, user_message
from ...io.archives.npz import save_body
from ...io.body_models.smpl_writer import write_body_model
from ...io.kinds import identify
from ...io.meshes.mesh import read_mesh, write_mesh
from ...io.opensim.osim import read_osim
from ...io.opensim.storage import SUFFIXES as STORAGE_SUFFIXES
from ...io.opensim.storage import find_outside, read_coordinates, read_storage
from ...io.registry import (
    NPZ_CONVENTIONS,
    is_skinned,
    read_marker_file,
    read_skinned,
    write_angles,
    write_markers,
    write_motion,
    write_skeleton,
)
from ...io.skeletons.amass import GENDERS, MotionUp, is_amass, read_amass, read_amass_shape, write_amass
from ...io.skinned.clip import split_clip
from ..body_models import is_model_spec, load_shaped_body, split_model, takes_shape
from ..console.console import pluralise, say, warn
from ..console.options import BODY_FORMATS, Flag, OptionalFile, OptionalUnit, arg
from ..motions import load_body_motion, load_motion, load_skeleton, warn_of_clip
from ..outputs import check_absent
from ..sources import is_human_spec, load_body
from .between_bodies import check_target, convert_between_bodies, still_motion
from .body import write_linear_body
from .conversion_kind import PURPOSES, ConversionKind, check_options, check_units, find_conversion
from .points import check_marker_unit, read_labels, write_points
from .surface import check_single, write_surface

#: metres, and bones per vertex
TOLERANCE, INFLUENCES = 0.001, 4


@dataclass
class Convert:
    """Convert a motion, a body, a skeleton, a mesh or markers to another format. The suffixes of the files determine
    the conversion.

    A motion is written as .bvh or .npz, its joint centres as .trc, .c3d or .csv, and with --as angles its joint angles as
    .csv. A body is written with its skin
    as .glb, .usda, .usdc or .usdz, together with its motion if SOURCE or --motion contains one. `human` is also
    written as a body .npz; for all other bodies, this needs --as body. The surface alone is written as .off, .obj, .ply or .stl:
    at rest, or in each frame of a motion to files such as mesh_%04d.obj. A skeleton is written as .skl, a mesh as .off,
    .obj, .ply or .stl, and markers as .c3d, .trc or .csv."""

    source: tyro.conf.Positional[Annotated[Path, arg(metavar="SOURCE")]]
    """A motion, body, skeleton, mesh or markers, in any format that is read. `character.glb:Walk` selects one of
    several clips."""
    target: tyro.conf.Positional[Annotated[Path, arg(metavar="TARGET")]]
    """Output file. Its suffix determines the format."""
    unit: OptionalUnit = None
    """Unit of the source's lengths. Default: the unit stated in the file, else metres, or centimetres for BVH. Markers
    that do not have the size of a body in that unit are refused; --unit also converts them."""
    target_unit: OptionalUnit = None
    """Unit of the target's lengths. Default: metres; centimetres for BVH, millimetres for TRC and C3D."""
    motion: OptionalFile = None
    """Motion to write with a body in a .glb or USD, or as meshes, from any file with a motion."""
    body: OptionalFile = None
    """Body of the motion, for files without joint positions, such as AMASS or OpenSim's .mot (with an .osim), for --vertices, and to write a motion with its body
    as .glb, USD or meshes: `human`, or any file with a body. A body model takes the shape (`betas`) of a motion in AMASS format."""
    to: Annotated[
        str | None,
        arg(
            metavar="BODY",
            help_behavior_hint="",
            help=f"Body to which the motion is converted by the surfaces of both: {BODY_FORMATS}. "
            "A body model, or `human` without a build, takes the shape of the source; its coefficients are written with the motion, or "
            "its body to TARGET_body.npz. Without --body the source is a body, or joints only.",
        ),
    ] = None
    as_: Annotated[
        Literal["amass", "angles", "body", "smpl"] | None,
        arg(name="as", metavar="amass|angles|body|smpl", help_behavior_hint=""),
    ] = None
    """Content of the target: `amass`, a motion in AMASS format as .npz (`poses`, `trans`, `betas`, `gender` and the rate, z
    up); `angles`, the joint angles of a person as .csv, in degrees, as biomechanics defines them; `body`, the body of
    SOURCE as .npz; `smpl`, the body of SOURCE as a body model in SMPL's format, .npz."""
    up: Annotated[MotionUp | None, arg(metavar="y|z|-y", help_behavior_hint="")] = None
    """Up axis of a motion in AMASS format; -y (--up=-y) is that of a camera. Default: the axis stated in the file, else z."""
    rate: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")] = None
    """Frames per second of a motion in AMASS format that states none."""
    vertices: Annotated[tuple[str, ...], arg(metavar="VERTEX...", help_behavior_hint="")] = ()
    """Vertices of --body to write as markers, in addition to the joints (not a number of vertices): numbers, NAME=NUMBER, or a text file of
    names and numbers."""
    tolerance: float = TOLERANCE
    """Largest error of the surface in a .glb or USD, metres, for a body without linear blend skinning. Virtual bones
    are added to reduce the error."""
    influences: int = INFLUENCES
    """Largest number of bones per vertex in a .glb or USD. Many programs read at most 4."""
    overwrite: Flag = False
    """Replace the target if it exists."""

    def run(self) -> None:
        check_absent([self.target], self.overwrite)
        human = is_human_spec(str(self.source))
        model = is_model_spec(str(self.source))
        if not human and not model and not split_clip(self.source)[0].exists():
            raise InputError(f"{self.source}: there is no such file; check the path.")
        if self.to is not None:
            self.convert_to(self.to)
            return
        # the human counts as a body file
        own = self.as_ in ("body", "smpl") or (human and self.target.suffix.lower() == ".npz")
        way: ConversionKind = (
            "own"
            if own
            else "angles"
            if self.as_ == "angles"
            else find_conversion(
                split_model(str(self.source))[0] if model else self.source,
                self.target,
                human,
                self.body is not None,
                self.motion is not None,
            )
        )
        self.check(way)
        {
            "own": self.write_own,
            "body": self.write_body,
            "surface": self.write_surface,
            "motion": self.write_motion,
            "points": self.write_points,
            "markers": self.write_markers,
            "mesh": self.write_mesh,
            "skeleton": self.write_skeleton,
            "angles": self.write_angles,
        }[way]()

    def convert_to(self, to: str) -> None:
        """Convert the source to another body."""
        for name, value in (
            ("as", self.as_),
            ("vertices", self.vertices),
            ("motion", self.motion),
            ("target-unit", self.target_unit),
        ):
            if value:
                raise InputError(f"{self.target}: --{name} and --to were both given; give one of them.")
        check_target(self.target)
        self.check_amass_options(self.source)
        convert_between_bodies(
            self.read_source(),
            self.source,
            to,
            self.target,
            tolerance=self.tolerance,
            influences=self.influences,
            overwrite=self.overwrite,
        )

    def read_source(self) -> tuple[Body | Skeleton, Motion]:
        """Read the motion of `--to` with its body, or with its skeleton only; a body alone is at rest."""
        if self.body is not None:
            skeleton, motion, body = self.read_motion()
            return body or skeleton, motion
        spec = str(self.source)
        if is_human_spec(spec) or is_model_spec(spec) or identify(self.source) in ("body", "rigged"):
            body = load_body(spec, unit=self.unit or "m")[0]
            return body, still_motion(body)
        if is_skinned(self.source):
            body, motion = read_skinned(self.source)
            return body, still_motion(body) if motion is None else motion
        return self.motion_of(self.source, None)

    def check(self, kind: ConversionKind) -> None:
        """Check that the given options apply to the conversion. Raises `InputError`."""
        given = {
            "motion": self.motion,
            "body": self.body,
            "as amass": self.as_ == "amass",
            "as angles": self.as_ == "angles",
            "as body": self.as_ == "body",
            "as smpl": self.as_ == "smpl",
            "vertices": self.vertices,
            "up": self.up,
            "rate": self.rate is not None,
            "tolerance": self.tolerance != TOLERANCE,
            "influences": self.influences != INFLUENCES,
        }
        check_options(kind, self.target, given)
        check_units(kind, self.source, self.target, self.unit, self.target_unit)
        read = self.motion if kind in ("body", "surface") and self.body is None else self.source
        self.check_amass_options(read)

    def check_amass_options(self, motion: Path | None) -> None:
        """Check that options for motions in AMASS's format are given for these only. Raises `InputError`."""
        for name, value, others in (
            ("up", self.up, "other motions have y up"),
            ("rate", self.rate, "other motions state their rate; `jaxcap edit resample` changes it"),
        ):
            if value is not None and (motion is None or not is_amass(motion)):
                raise InputError(f"{motion or self.target}: --{name} is for {PURPOSES[name][0]}; {others}.")

    def read_motion(self) -> tuple[Skeleton, Motion, Body | None]:
        """Read the source's motion, with the given body if any."""
        if self.body is not None and self.body.suffix.lower() == ".osim":
            # it has no surface
            if self.source.suffix.lower() not in STORAGE_SUFFIXES:
                raise InputError(
                    f"{self.body}: an OpenSim model is the body of coordinates ({', '.join(STORAGE_SUFFIXES)}), and {self.source.name} "
                    "has none."
                )
            model = read_osim(self.body).model
            values, motion = read_coordinates(self.source, model)
            outside = find_outside(model, values)
            if outside:
                warn(
                    f"{self.source}: coordinates are outside of the model's ranges, so it may be another model: {', '.join(outside)}"
                )
            return model.skeleton, motion, None
        if self.body is None:
            return *self.motion_of(self.source, None), None
        body = self.body_of_motion(self.source)
        return *self.motion_of(self.source, body), body

    def body_of_motion(self, motion: Path) -> Body:
        """Load the given body; a body model in the shape that a motion in AMASS format has."""
        spec = str(self.body)
        if takes_shape(spec, motion):
            return load_shaped_body(spec, motion)
        return load_body(spec, unit=self.unit or "m")[0]

    def motion_of(self, path: Path, body: Body | None) -> tuple[Skeleton, Motion]:
        if is_amass(path):
            return read_amass(path, None if body is None else body.skeleton, self.up, self.rate)
        skeleton, motion = (
            load_motion(path, self.unit)
            if body is None
            else (body.skeleton, load_body_motion(body, path, self.unit))
        )
        if not len(motion):
            raise InputError(f"{path}: this motion has no frames.")
        return skeleton, motion

    def write_own(self) -> None:
        body = load_body(str(self.source), unit=self.unit or "m")[0]
        if self.as_ == "smpl":
            write_body_model(self.target, body)
        else:
            save_body(self.target, body)
        say(f"{self.target}: {len(body.vertices)} vertices, {body.skeleton.num_joints} joints")

    def write_body(self) -> None:
        write_linear_body(self.target, *self.read_moving_body(), self.tolerance, self.influences)

    def write_surface(self) -> None:
        write_surface(self.target, *self.read_moving_body(), self.target_unit, self.overwrite)

    def read_moving_body(self) -> tuple[Body, Motion | None]:
        """Read the body, and its motion if there is one."""
        if self.body is not None and self.motion is not None:
            raise InputError(
                f"{self.target}: --body and --motion were both given; give the body as SOURCE and --motion, or the motion as SOURCE "
                "and --body."
            )
        if self.body is not None and self.body.suffix.lower() == ".osim":
            raise InputError(
                f"{self.body}: an OpenSim model has no surface; write its motion as .bvh, or convert it to a body with --to."
            )
        if self.body is not None:
            body = self.body_of_motion(self.source)
            return body, self.motion_of(self.source, body)[1]
        spec, motion = str(self.source), None
        if is_skinned(self.source):
            body, motion = read_skinned(self.source)
            warn_of_clip(self.source)
        elif self.motion is not None and takes_shape(spec, self.motion):
            body = load_shaped_body(spec, self.motion)
        else:
            body = load_body(spec, unit=self.unit or "m")[0]
        return body, motion if self.motion is None else self.motion_of(self.motion, body)[1]

    def write_motion(self) -> None:
        skeleton, motion, _ = self.read_motion()
        if self.as_ and is_amass(self.source):
            shape, gender = read_amass_shape(self.source)
            write_amass(self.target, skeleton, motion, shape, gender if gender in GENDERS else "neutral")
        elif self.as_:
            NPZ_CONVENTIONS[self.as_](self.target, skeleton, motion)
        else:
            write_motion(self.target, skeleton, motion, self.target_unit)
        say(f"{self.target}: {pluralise(motion.num_frames, 'frame')} at {motion.rate:g} frames per second")

    def write_angles(self) -> None:
        skeleton, motion, _ = self.read_motion()
        try:
            angles = joint_angles(skeleton, motion)
        except InputError as error:
            raise InputError(f"{self.source}: {user_message(error)}") from None
        # a table of coordinates may begin later, as the forces of its trial do
        start = read_storage(self.source).start if self.source.suffix.lower() in STORAGE_SUFFIXES else 0.0
        write_angles(self.target, angles, start)
        missing = angles.describe_missing()
        if missing is not None:
            warn(f"{self.source}: {missing}")
        say(
            f"{self.target}: {pluralise(len(angles.names), 'joint angle')} in degrees, "
            f"{pluralise(motion.num_frames, 'frame')} at {motion.rate:g} frames per second"
        )

    def write_points(self) -> None:
        # labels are checked before a long motion is read
        labels = read_labels(self.vertices)
        skeleton, motion, body = self.read_motion()
        write_points(self.target, skeleton, motion, body, labels, self.target_unit)

    def write_markers(self) -> None:
        file = read_marker_file(self.source, self.unit)
        frames = file.frames
        if self.unit is None:
            check_marker_unit(file, self.source)
        write_markers(self.target, frames, self.target_unit)
        for sentence in file.warnings:
            warn(f"{self.source.name}: {sentence}")
        say(
            f"{self.target}: {pluralise(len(frames.labels), 'marker')}, {pluralise(len(frames), 'frame')} at {frames.rate:g} frames per second"
        )

    def write_mesh(self) -> None:
        check_single(self.target)
        mesh = read_mesh(self.source, self.unit or "m")
        write_mesh(self.target, mesh, self.target_unit or "m")
        say(f"{self.target}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces")

    def write_skeleton(self) -> None:
        skeleton = load_skeleton(self.source, self.unit)
        write_skeleton(self.target, skeleton, self.target_unit)
        say(f"{self.target}: {skeleton.num_joints} joints")
