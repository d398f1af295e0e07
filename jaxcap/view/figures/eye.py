"""Camera positions from which the whole scene is visible."""

import numpy as np
from jaxtyping import Float

#: field of view of all windows, radians; wider ones distort near objects
FIELD = np.radians(40.0)
#: directions from the target to the camera; y is up and z the front
BEGIN, FRONT, SIDE, TOP = "Begin", "Front", "Side", "Top"
DIRECTIONS = {
    BEGIN: (0.22, 0.2, 1.0),
    FRONT: (0.0, 0.0, 1.0),
    SIDE: (1.0, 0.0, 0.0),
    # not exactly vertical, as an orbit camera must not look along its up axis
    TOP: (0.0, 1.0, 1e-3),
}
#: share of the image that is filled
FILL_SHARE = 0.88


def place_camera(
    box: Float[np.ndarray, "2 3"],
    name: str = BEGIN,
    width: float = 900.0,
    height: float = 600.0,
    field: float = float(FIELD),
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Place a camera so that a whole box, metres, is visible; return its position and its target.

    **Arguments:** `name` of a direction; `width` and `height` of the image, pixels; `field`, the vertical
    field of view, radians.
    """
    back = np.array(DIRECTIONS[name]) / np.linalg.norm(DIRECTIONS[name])
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back])
    corners = np.stack(np.meshgrid(*box.T, indexing="ij"), -1).reshape(-1, 3)
    middle = box.mean(0)
    across, up, near = axes @ (corners - middle).T
    slope = FILL_SHARE * np.tan(0.5 * field)
    away = np.max(near + np.maximum(np.abs(across) * height / width, np.abs(up)) / slope)
    return middle + max(away, 1e-3) * back, middle
