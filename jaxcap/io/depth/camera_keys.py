"""Keys of the intrinsics of cameras in JSON files of other programs, and where the files have them."""

from typing import Any

from ...errors import InputError

#: keys of the matrix of intrinsics: Open3D, OpenCV, and scripts that write OpenCV's and ROS's names
MATRIX_KEYS = ("intrinsic_matrix", "camera_matrix", "cameraMatrix", "K", "mtx")
#: keys of the width and the height of images, and of both in one list
SIZE_KEYS = (("width", "image_width"), ("height", "image_height"))
SIZE_LIST_KEYS = ("image_size", "imageSize")
_KEYS = ("intrinsic", *MATRIX_KEYS, "fx", *SIZE_KEYS[0], *SIZE_LIST_KEYS)
#: what a file of cameras may contain
ACCEPTED = (
    "expected fx, fy, cx, cy (or ppx, ppy), or a matrix named "
    f"{', '.join(MATRIX_KEYS[:-1])} or {MATRIX_KEYS[-1]}, with width and height, image_width and image_height, or image_size; "
    "or a list 'cameras' of at least one camera: see docs/files.md#cameras"
)


def list_intrinsics(content: object) -> list[dict[str, Any]]:
    """List the objects that have intrinsics in the content of a JSON file; none if it is of another type.

    These are the object itself, its `depth` as scripts of RealSense write it, the objects of a list, or the `parameters` of
    a trajectory of Open3D.
    """
    if isinstance(content, dict) and isinstance(content.get("parameters"), list):
        content = content["parameters"]
    if isinstance(content, list):
        return content if all(map(_has_intrinsics, content)) else []
    if not isinstance(content, dict):
        return []
    inner = content.get("depth")
    found: Any = inner if _has_intrinsics(inner) else content
    return [found] if _has_intrinsics(found) else []


def incomplete_error(where: str, found: str) -> InputError:
    """Make the error of a file of cameras that is not read; `found` is a clause on what it has."""
    return InputError(f"{where}: {found}; {ACCEPTED}.")


def _has_intrinsics(content: object) -> bool:
    return isinstance(content, dict) and any(name in content for name in _KEYS)
