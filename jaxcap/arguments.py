"""Validation of arguments of public classes and functions against their annotations.

Only shapes, dtypes and types are checked, never values. So nothing is copied from a device, and traced
arrays are checked like any others. JAX rebuilds modules inside `vmap`, `tree_map` and `scan` without their
constructors; the contents of such modules are not checked.
"""

import collections.abc
import dataclasses
import functools
import inspect
import numbers
import os
import sys
import types
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

import numpy as np

from .errors import InputError, TracedArgumentError, is_user_error, user_message

Function = TypeVar("Function", bound=Callable)
#: length of each named dimension, with the field or argument that has it
Lengths = dict[str, tuple[Any, str]]


def check_fields(module: Any) -> Lengths:
    """Check the fields of a dataclass against their annotations; for `__check_init__` of an
    `equinox.Module`.

    Returns the lengths of the named dimensions of the annotations, each with a field that has it.

    **Raises:** `InputError` with the class, the field, the given value and the expected one.
    """
    lengths: Lengths = {}
    for name, annotation in _fields(type(module)):
        _check(type(module).__name__, name, annotation, getattr(module, name), lengths)
    return lengths


def dimension_lengths(module: Any) -> Lengths:
    """Collect the lengths of the named dimensions of a checked module's arrays."""
    lengths: Lengths = {}
    for name, annotation in _fields(type(module)):
        _mismatch(annotation, getattr(module, name), lengths, name)
    return lengths


def check_length(module: Any, name: str, length: int, lengths: Lengths, dim: str) -> None:
    """Check that the length of a field equals the dimension `dim` of other fields.

    **Raises:** `InputError` with the class, the field, the given value and the expected one.
    """
    size, owner = lengths.get(dim, (length, name))
    if length != size:
        raise InputError(
            f"{type(module).__name__}: `{name}` has length {length}; expected {size}, dimension {dim} of `{owner}`."
        )


@functools.cache
def _fields(cls: Any) -> tuple[tuple[str, Any], ...]:
    return tuple(
        (field.name, field.type) for field in dataclasses.fields(cls) if not isinstance(field.type, str)
    )


def checked(function: Function) -> Function:
    """Decorate a public function so that its arguments are checked against their annotations at each call.

    Arrays must have the shapes and dtypes of the annotation, with equal lengths for dimensions of one name.
    Poses must have as many joints as the body or skeleton passed with them. A `ValueError` that the package
    raises inside becomes an `InputError` that begins with the name of the function.

    **Raises:** `InputError` with the function, the argument, the given value and the expected one.
    """
    signature, name = inspect.signature(function), getattr(function, "__name__", str(function))

    @functools.cache
    def hints() -> dict[str, Any]:
        try:
            found = typing.get_type_hints(inspect.unwrap(function))
        except NameError:
            # a name that is imported for type checkers only
            found = {key: value.annotation for key, value in signature.parameters.items()}
        return {key: value for key, value in found.items() if not isinstance(value, str) and key != "return"}

    @functools.wraps(function)
    def wrapper(*arguments, **named):
        try:
            given = signature.bind(*arguments, **named).arguments
        except TypeError as error:
            raise InputError(
                f"{name}: {error}; expected arguments: {describe_signature(signature)}."
            ) from None
        lengths: Lengths = {}
        for key, value in given.items():
            kind = signature.parameters[key].kind
            if key in hints() and kind not in (kind.VAR_POSITIONAL, kind.VAR_KEYWORD):
                _check(name, key, hints()[key], value, lengths)
        _check_joints(name, given)
        try:
            return function(*arguments, **named)
        except (TracedArgumentError, TypeError) as error:
            # as below, with the argument of that function
            traced = _traced_arguments(error, given)
            if not traced:
                raise
            raise TracedArgumentError(traced[0], name) from None
        except ValueError as error:
            # an error of another class has fields of its own, and one without a function is of a file
            if type(error) not in (ValueError, InputError) or not is_user_error(error):
                raise
            if isinstance(error, InputError) and not error.function:
                raise
            # the name becomes that of the outermost function, which the user has called
            raise InputError(user_message(error), name) from None

    return typing.cast(Function, wrapper)


def _traced_arguments(error: Exception, given: dict[str, Any]) -> list[str]:
    """List the arguments with traced arrays, if these are the reason of an error."""
    # JAX is loaded where it has raised an error
    jax = sys.modules.get("jax")
    if jax is None or not isinstance(error, (jax.errors.JAXTypeError, TracedArgumentError)):
        return []
    tracer = jax.core.Tracer
    return [
        key
        for key, value in given.items()
        if any(isinstance(leaf, tracer) for leaf in jax.tree.leaves(value))
    ]


def describe_signature(signature: inspect.Signature) -> str:
    """List the names of a function's arguments, optional ones in brackets."""
    words = [
        key if value.default is value.empty else f"[{key}]" for key, value in signature.parameters.items()
    ]
    return ", ".join(words) or "none"


def describe(value: Any) -> str:
    """Describe a given value in words: an array by its dtype and shape, any other object by its class."""
    if value is None or isinstance(value, (bool, int, float)):
        return f"is {value}"
    if isinstance(value, (str, Path)):
        return f"is {str(value)[:40]!r}"
    if _is_array(value):
        traced = "traced " if "Tracer" in type(value).__name__ else ""
        return f"is {_with_article(traced + _dtype_name(value))} array of shape {_shape(value)}"
    if isinstance(value, type):
        return f"is the class {value.__name__} itself"
    return f"is {_with_article(type(value).__name__)}"


def _with_article(words: str) -> str:
    return f"{'an' if words[:1].lower() in tuple('aeiou') else 'a'} {words}"


def as_jax_array(value: Any) -> Any:
    """Convert a field to a JAX array where possible; leave any other value to `check_fields`."""
    import jax.numpy as jnp

    try:
        return jnp.asarray(value)
    except (TypeError, ValueError):
        return value


def as_real_array(where: str, name: str, value: Any) -> np.ndarray:
    """Convert any real numbers to a floating-point array. Raises `InputError` for anything else."""
    try:
        given = np.asarray(value)
        if given.dtype.kind != "c":
            return given.astype(float)
        value = given
    except (TypeError, ValueError):
        if "Tracer" in type(value).__name__:
            raise TracedArgumentError(name, where) from None
    raise InputError(f"{where}: `{name}` {describe(value)}; expected an array of real numbers.")


def _check(where: str, name: str, annotation: Any, value: Any, lengths: Lengths) -> None:
    expected = _mismatch(annotation, value, lengths, name)
    if expected is not None:
        raise InputError(f"{where}: `{name}` {describe(value)}; expected {expected}.")


def _mismatch(annotation: Any, value: Any, lengths: Lengths, name: str) -> str | None:
    """Compare a value with an annotation: return None where it fits, else the expected value in words."""
    is_array, origin, parts = _parse_annotation(annotation)
    if is_array:
        return _array_mismatch(annotation, value, lengths, name)
    if origin in (Union, types.UnionType):
        return _union_mismatch(parts, value, lengths, name)
    if origin is Literal:
        return None if value in parts else f"one of {', '.join(map(repr, parts))}"
    if annotation in (None, type(None)):
        return None if value is None else "None"
    if origin is not None:
        return _generic_mismatch(origin, parts, value, lengths, name)
    if not isinstance(annotation, type):
        return None
    return None if _is_instance(value, annotation) else _describe_type(annotation)


@functools.cache
def _parse_annotation(annotation: Any) -> tuple[bool, Any, tuple]:
    """Parse an annotation: if it is of an array, and the origin and parts of a generic type."""
    is_array = hasattr(annotation, "dim_str") and hasattr(annotation, "dtypes")
    return is_array, typing.get_origin(annotation), typing.get_args(annotation)


def _union_mismatch(parts: tuple, value: Any, lengths: Lengths, name: str) -> str | None:
    expected = []
    for part in parts:
        own = dict(lengths)
        wanted = _mismatch(part, value, own, name)
        if wanted is None:
            lengths.update(own)
            return None
        expected.append(wanted)
    return " or ".join(dict.fromkeys(expected))


def _generic_mismatch(origin: Any, parts: tuple, value: Any, lengths: Lengths, name: str) -> str | None:
    if origin is collections.abc.Callable:
        return None if callable(value) else "a function"
    if origin in (dict, collections.abc.Mapping):
        return None if isinstance(value, collections.abc.Mapping) else "a mapping"
    if origin not in (list, tuple, collections.abc.Sequence, collections.abc.Iterable):
        return None
    of = _describe_type(parts[0]) if parts and isinstance(parts[0], type) else "its elements"
    if isinstance(value, (str, bytes)) or not (hasattr(value, "__iter__") or hasattr(value, "__getitem__")):
        return f"a sequence of {of.removeprefix('a ').removeprefix('an ')}"
    fixed = origin is tuple and parts and parts[-1] is not Ellipsis
    if not isinstance(value, (list, tuple)) or not parts:
        return None
    if fixed and len(value) != len(parts):
        return f"{len(parts)} elements"
    for number, element in enumerate(value):
        wanted = _mismatch(parts[number] if fixed else parts[0], element, {}, name)
        if wanted is not None:
            return f"{wanted} at index {number}, which {describe(element)}"
    return None


def _is_instance(value: Any, cls: type) -> bool:
    scalar = _is_array(value) and _shape(value) == ()
    if cls is float:
        return isinstance(value, numbers.Real) or (
            scalar and _dtype_name(value) in ("floating-point", "integer")
        )
    if cls is int:
        return isinstance(value, numbers.Integral) or (scalar and _dtype_name(value) == "integer")
    if cls is bool:
        return isinstance(value, (bool, np.bool_)) or (scalar and _dtype_name(value) == "boolean")
    if cls is Path:
        return isinstance(value, (str, os.PathLike))
    try:
        return isinstance(value, cls)
    except TypeError:
        # a protocol that is not checkable at run time
        return True


def _array_mismatch(annotation: Any, value: Any, lengths: Lengths, name: str) -> str | None:
    given, dims = _array_like(value), _dims(annotation)
    if (
        given is not None
        and _numbers_fit(annotation, given)
        and _lengths_fit(dims, _shape(given), lengths, name)
    ):
        return None
    kind = getattr(annotation.dtype, "__name__", "").lower()
    what = {"float": "floating-point ", "int": "integer ", "integer": "integer ", "bool": "boolean "}.get(
        kind, ""
    )
    if not dims:
        return f"one {what}number"
    shape = ", ".join("..." if dim[0] in "*." else dim.lstrip("#_") or "any" for dim in dims)
    known = {dim: lengths[dim] for dim in dims if dim in lengths}
    where = " and ".join(f"{dim} is {size} as in `{owner}`" for dim, (size, owner) in known.items())
    return f"{_with_article(what + 'array')} of shape ({shape}{',' * (len(dims) == 1)})" + (
        f", where {where}" if where else ""
    )


@functools.cache
def _dims(annotation: Any) -> tuple[str, ...]:
    return tuple(annotation.dim_str.split())


def _array_like(value: Any) -> Any:
    """Convert a number to an array and return arrays unchanged; return None for anything else."""
    if isinstance(value, (bool, int, float, np.generic)):
        return np.asarray(value)
    return value if _is_array(value) else None


def _numbers_fit(annotation: Any, value: Any) -> bool:
    # a plain Python integer is accepted as a floating-point number
    plain = isinstance(value, np.ndarray) and value.shape == () and value.dtype.kind in "iu"
    return _dtype_fits(annotation, value.dtype) or (plain and _dtype_fits(annotation, np.dtype(np.float32)))


@functools.cache
def _dtype_fits(annotation: Any, dtype: Any) -> bool:
    names, given = annotation.dtypes, "prng_key" if str(dtype).startswith("key<") else str(dtype)
    return not isinstance(names, (list, tuple)) or given in names


def _lengths_fit(dims: tuple[str, ...], shape: tuple, lengths: Lengths, name: str) -> bool:
    """Test if a shape has the lengths of an annotation, equal for equal names; add new names to `lengths`."""
    variadic = [number for number, dim in enumerate(dims) if dim[0] in "*."]
    if variadic:
        before, after = variadic[0], len(dims) - variadic[0] - 1
        if len(shape) < before + after:
            return False
        # `*frames` have the same shape in all arguments
        whole = shape[before : len(shape) - after]
        if lengths.setdefault(dims[before], (whole, name))[0] != whole and dims[before] != "...":
            return False
        shape = (*shape[:before], *shape[len(shape) - after :])
        dims = (*dims[:before], *dims[before + 1 :])
    if len(dims) != len(shape):
        return False
    found: Lengths = {}
    for dim, size in zip(dims, shape, strict=True):
        if dim.isdigit():
            if size != int(dim):
                return False
        elif dim.isidentifier() and not dim.startswith("_"):
            if {**lengths, **found}.get(dim, (size, ""))[0] != size:
                return False
            found.setdefault(dim, (size, name))
    for dim, entry in found.items():
        lengths.setdefault(dim, entry)
    return True


def _check_joints(where: str, arguments: dict[str, Any]) -> None:
    """Check that poses and motions have as many joints as the one body or skeleton passed with them."""
    poses = {key: shape for key, value in arguments.items() if (shape := _rotations_shape(value)) is not None}
    if not poses:
        return
    owners = {key: count for key, value in arguments.items() if (count := _num_joints(value)) is not None}
    if len(owners) != 1:
        return
    ((owner, count),) = owners.items()
    for key, shape in poses.items():
        there = shape[-2] if len(shape) > 1 else None
        if key != owner and there != count:
            raise InputError(
                f"{where}: `{key}` has {there} joints; expected {count} as in `{owner}`; give one of "
                "this skeleton, such as rest_pose(skeleton), or retarget it."
            )


def _rotations_shape(value: Any) -> tuple | None:
    """Return the shape of the rotations of a pose or a motion; None for anything else."""
    pose = getattr(value, "poses", value)
    shape = getattr(getattr(pose, "rotations", None), "shape", None)
    return shape if hasattr(pose, "scale") else None


def _num_joints(value: Any, depth: int = 2) -> int | None:
    """Return the number of joints of a skeleton or of an object that contains one; None where there is
    none, or where several differ."""
    joints = getattr(value, "num_joints", None)
    if isinstance(joints, int):
        return joints
    within = vars(value).values() if depth and dataclasses.is_dataclass(value) else ()
    counts = {count for field in within if (count := _num_joints(field, depth - 1)) is not None}
    return counts.pop() if len(counts) == 1 else None


def _describe_type(cls: type) -> str:
    plain = {int: "an integer", float: "a number", bool: "True or False", str: "a string", Path: "a path"}
    return plain.get(cls, _with_article(cls.__name__))


def _is_array(value: Any) -> bool:
    return hasattr(value, "dtype") and isinstance(getattr(value, "shape", None), tuple)


def _shape(value: Any) -> tuple:
    return tuple(value.shape)


def _dtype_name(value: Any) -> str:
    kinds = {"f": "floating-point", "i": "integer", "u": "unsigned integer", "b": "boolean", "c": "complex"}
    name = str(value.dtype)
    return "floating-point" if "float" in name else kinds.get(getattr(value.dtype, "kind", ""), name)
