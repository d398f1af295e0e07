"""Places that an eye sees everything from."""

import numpy as np
from jaxtyping import Float

#: of all windows, radians; wider ones bend what is near
FIELD = np.radians(40.0)
#: from what is seen towards the eye, where y is up and z the front
BEGIN, FRONT, SIDE, TOP = "Begin", "Front", "Side", "Top"
DIRECTIONS = {
    BEGIN: (0.22, 0.2, 1.0),
    FRONT: (0.0, 0.0, 1.0),
    SIDE: (1.0, 0.0, 0.0),
    # not quite, as an eye that turns about the vertical must not look along it
    TOP: (0.0, 1.0, 1e-3),
}
#: how much of the picture is filled
FILLED = 0.88


def place_eye(
    box: Float[np.ndarray, "2 3"],
    name: str = BEGIN,
    width: float = 900.0,
    height: float = 600.0,
    field: float = float(FIELD),
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Place an eye so that it sees a whole box, metres; returns where it is and what it looks at.

    **Arguments:** `name` of a direction; `width` and `height` of the picture, pixels; `field` of view from top to
    bottom, radians.
    """
    back = np.array(DIRECTIONS[name]) / np.linalg.norm(DIRECTIONS[name])
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back])
    corners = np.stack(np.meshgrid(*box.T, indexing="ij"), -1).reshape(-1, 3)
    middle = box.mean(0)
    across, up, near = axes @ (corners - middle).T
    slope = FILLED * np.tan(0.5 * field)
    away = np.max(near + np.maximum(np.abs(across) * height / width, np.abs(up)) / slope)
    return middle + max(away, 1e-3) * back, middle
