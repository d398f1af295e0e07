"""The embedded human as a user names it: a build in words, or a body model whose coefficients are those of people."""

from pathlib import Path
from typing import Any

import equinox as eqx

from ...adapt.shape.shape_space import shape_space_like
from ...body.body import Body
from ...body.body_model import BodyModel
from ...body.people.human import RESOLUTIONS, human
from ...errors import InputError, user_message

#: option of the number of coefficients of the human as a body model
_BETAS = "betas"
#: largest number of coefficients: of the principal components of the sampled people
MAX_BETAS = 30


def is_human_spec(spec: str) -> bool:
    """Check if an argument means the embedded `human`, with or without options, and not a file of that
    name."""
    return spec.split(":")[0] == "human" and not Path(spec).exists()


def is_human_model(spec: str) -> bool:
    """Test if an argument means the human as a body model: `human:betas=20`, with further options such as `female`."""
    if not is_human_spec(spec) or spec.startswith("human:anny"):
        return False
    return any(word.startswith(f"{_BETAS}=") for word in spec[6:].split(","))


def load_human(spec: str, vertices: int | None, **options: Any) -> Body:
    """Make the human of an argument; `options` of `human` replace those of a verb. Raises `InputError`."""
    options = {"joints": "tracking", "resolution": "medium" if vertices is None else "full", **options}
    for word in filter(None, spec[6:].split(",")):
        key, _, value = word.partition("=")
        if word in ("female", "male"):
            options["sex"] = word
        elif word in RESOLUTIONS:
            options["resolution"] = word
        elif key in ("age", "weight", "muscle", "height"):
            try:
                options[key] = float(value)
            except ValueError:
                raise InputError(f"{spec}: '{value}' for the {key} is not a number.") from None
        else:
            raise InputError(
                f"{spec}: '{word}' is not an option of the human; give female, male, "
                f"{', '.join(RESOLUTIONS)}, or age, weight, muscle, height with =NUMBER, or betas=NUMBER for a build that is fitted."
            )
    try:
        return human(**options)
    except ValueError as error:
        raise InputError(f"{spec}: {user_message(error)}") from None


def load_human_model(spec: str, num_betas: int | None = None, joints: str = "tracking") -> BodyModel:
    """Make the human as a body model: its coefficients are those of the principal components of 200 people.

    The template is the build that the other options name, and zeros are the mean of the people.

    **Arguments:** `num_betas`, the number of coefficients in place of that of the argument; `joints` of `human`.

    **Raises:** `InputError`.
    """
    words = spec[6:].split(",")
    stated = next(word.partition("=")[2] for word in words if word.startswith(f"{_BETAS}="))
    if not stated.isdecimal() or not 1 <= int(stated) <= MAX_BETAS:
        raise InputError(f"{spec}: {_BETAS}={stated} is no number of coefficients from 1 to {MAX_BETAS}.")
    others = ",".join(word for word in words if not word.startswith(f"{_BETAS}="))
    template = load_human(f"human:{others}", None, joints=joints)
    space = shape_space_like(load_human(f"human:{others}", None))
    assert space is not None
    count = min(int(stated) if num_betas is None else num_betas, len(space.template_coefficients))
    return BodyModel(
        template=template,
        modes=eqx.tree_at(
            lambda m: (m.centres, m.vertices),
            space.modes,
            (space.modes.centres[:count], space.modes.vertices[:count]),
        ),
        template_coefficients=space.template_coefficients[:count],
        groups=((_BETAS, count),),
        family="human",
    )
