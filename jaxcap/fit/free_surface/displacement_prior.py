"""The prior of the displacements of a surface: a smooth Gaussian random field."""

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ...arguments import checked
from ...geometry.laplacian import cotangent_laplacian
from ...geometry.mesh import vertex_areas
from ...value_checks import check_positive
from ..linear_solvers.regularised_blocks import PrecisionRoot, make_precision_root

#: least area of a vertex, as a share of the mean one
MIN_AREA = 0.01


@checked
def make_displacement_prior(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    deviation: float,
    length: float,
) -> PrecisionRoot:
    """Make the prior of a surface: a Matern field of smoothness one, `(k^2 - Laplacian) d = white noise`.

    The field is discretised by linear finite elements with lumped masses (Lindgren, Rue and Lindstrom 2011, eqs. 2 and
    10, alpha = 2), with `k = sqrt(8) / length`. Displacements that data do not determine decay to zero over about
    `length`. Returns the root of the precision of each coordinate, one over metres squared.

    **Arguments:** `deviation`, the standard deviation of each coordinate of a displacement, metres; `length`, the
    distance over the surface at which the correlation falls to 0.14, metres.

    **Raises:** `InputError` unless both are positive and finite.
    """
    check_positive("make_displacement_prior", "metres", deviation=deviation, length=length)
    frequency = np.sqrt(8.0) / length
    areas = vertex_areas(vertices, faces)
    areas = np.maximum(areas, MIN_AREA * areas.mean())
    amplitude = np.sqrt(4.0 * np.pi) * frequency * deviation
    operator = scipy.sparse.diags_array(frequency**2 * areas) + cotangent_laplacian(vertices, faces)
    rows = scipy.sparse.diags_array(1.0 / (amplitude * np.sqrt(areas))) @ operator
    return make_precision_root(scipy.sparse.csr_array(rows))
