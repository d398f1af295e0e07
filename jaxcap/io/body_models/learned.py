"""Body models of our own in `.npz`: a body, its shape modes, and the people from whom they were learned."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body_model import BodyModel
from ...body.shape_modes import ShapeModes
from ...errors import InputError
from ...value_checks import check_at_least
from ..archives.archive import array_names, load_arrays
from ..archives.npz import body_arrays, body_of, get_array, load_format, save_arrays
from ..system.reader_errors import reader_of

FORMAT = "jaxcap body model"
_PEOPLE, _COEFFICIENTS = "people.names", "people.coefficients"
_BOUNDS = ("lowest", "highest")


@checked
def save_body_model(
    path: str | Path,
    model: BodyModel,
    people: Mapping[str, Float[Array | np.ndarray, "K"]] | None = None,
) -> None:
    """Write a body model, for `read_body_model` and every verb that takes a body model.

    **Arguments:** `people`, the coefficients of known people by name, such as those from whom the model was learned
    (`read_model_people`).

    **Raises:** `InputError` if a person has another number of coefficients than the model, the skin cannot be written, or the
    file cannot be written.
    """
    count = len(model.template_coefficients)
    known = {name: np.asarray(values, float) for name, values in (people or {}).items()}
    for name, values in known.items():
        if len(values) != count:
            raise InputError(
                f"{path}: {name} has {len(values)} coefficients, and the model {count}; give all coefficients of each person."
            )
    bounds = {name: getattr(model, name) for name in _BOUNDS if getattr(model, name) is not None}
    groups = model.groups or (("betas", count),)
    arrays = {
        **body_arrays(model.template, path),
        "modes.centres": model.modes.centres,
        "modes.vertices": model.modes.vertices,
        "template_coefficients": model.template_coefficients,
        "group_names": np.array([name for name, _ in groups], dtype=str),
        "group_sizes": np.array([size for _, size in groups], int),
        "family": np.array(model.family, dtype=str),
        **{f"coefficients.{name}": values for name, values in bounds.items()},
    }
    if known:
        arrays |= {_PEOPLE: np.array(list(known), dtype=str), _COEFFICIENTS: np.stack(list(known.values()))}
    save_arrays(path, FORMAT, arrays)


@reader_of("a body model")
def read_own_model(
    path: str | Path,
    num_betas: int | None = None,
    num_expression: int = 0,
    joints: Literal["full", "tracking"] = "full",
) -> BodyModel:
    """Read a body model that `save_body_model` wrote.

    **Arguments:** `num_betas`, the number of the first coefficients of the group `betas` that are read; all if not given. The other
    groups are read whole. `num_expression` and `joints` have no effect: joints are of the kinds of the file.

    **Raises:** `InputError` if the file has another format, is damaged, or is inconsistent.
    """
    del num_expression, joints
    arrays = load_format(path, FORMAT)
    template = body_of(arrays, path)
    names = [str(name) for name in get_array(arrays, "group_names", path, (None,), "text")]
    sizes = get_array(arrays, "group_sizes", path, (len(names),), "whole").tolist()
    count = len(get_array(arrays, "template_coefficients", path, (None,)))
    if len(set(names)) < len(names) or min(sizes, default=1) < 0 or sum(sizes) != count:
        raise InputError(
            f"{path}: the groups {', '.join(names)} have {', '.join(map(str, sizes))} coefficients, and the model {count}; expected "
            "groups of different names with the same sum; write the model again."
        )
    modes = ShapeModes(
        *(
            jnp.asarray(get_array(arrays, f"modes.{name}", path, (count, number, 3), row_name="coefficient"))
            for name, number in (
                ("centres", template.skeleton.num_joints),
                ("vertices", len(template.vertices)),
            )
        )
    )
    lowest, highest = (
        jnp.asarray(get_array(arrays, f"coefficients.{name}", path, (count,)))
        if f"coefficients.{name}" in arrays
        else None
        for name in _BOUNDS
    )
    model = BodyModel(
        template,
        modes,
        jnp.asarray(get_array(arrays, "template_coefficients", path, (count,))),
        tuple(zip(names, sizes, strict=True)),
        str(get_array(arrays, "family", path, (), "text")),
        lowest,
        highest,
    )
    return model if num_betas is None else take_coefficients(model, {"betas": num_betas})


@checked
@reader_of("a body model")
def read_model_people(path: str | Path) -> dict[str, Float[np.ndarray, "K"]]:
    """Read the coefficients of the people from whom a model was learned, by name; `{}` if the file has none.

    **Raises:** `InputError` if the file is damaged.
    """
    if _PEOPLE not in array_names(path):
        return {}
    arrays = load_arrays(path, lambda name: name in (_PEOPLE, _COEFFICIENTS))
    names = get_array(arrays, _PEOPLE, path, (None,), "text")
    rows = get_array(arrays, _COEFFICIENTS, path, (len(names), None), row_name="person")
    return {str(name): row for name, row in zip(names, rows, strict=True)}


def is_own_model(path: str | Path) -> bool:
    """Test if a file is an `.npz` that `save_body_model` wrote, by the names of its arrays; false if it is damaged."""
    try:
        return Path(path).suffix.lower() == ".npz" and "modes.vertices" in array_names(path)
    except InputError:
        return False


def take_coefficients(model: BodyModel, numbers: Mapping[str, int]) -> BodyModel:
    """Keep the first coefficients of some groups, and all of the others. Raises `InputError` for a negative number."""
    check_at_least("read_body_model", 0, **{f"num_{name}": number for name, number in numbers.items()})
    groups, kept, first = [], [], 0
    for name, size in model.groups:
        number = min(size, numbers.get(name, size))
        kept += range(first, first + number)
        groups.append((name, number))
        first += size
    rows = np.array(kept, int)
    return BodyModel(
        model.template,
        ShapeModes(model.modes.centres[rows], model.modes.vertices[rows]),
        model.template_coefficients[rows],
        tuple(groups),
        model.family,
        *(None if end is None else end[rows] for end in (model.lowest, model.highest)),
    )
