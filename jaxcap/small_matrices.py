"""Products of stacks of matrices of a few rows and columns, written out term by term.

XLA compiles a batched product of 3 x 3 matrices on a CPU into one call for each matrix. Sums of products become a vectorised loop
that is fused with what stands around it, several times as fast.
"""

from jaxtyping import Array, Float


def multiply_small(a: Float[Array, "*N I K"], b: Float[Array, "*N K J"]) -> Float[Array, "*N I J"]:
    """Compute the products `a b` of small matrices."""
    terms = [a[..., :, k, None] * b[..., None, k, :] for k in range(a.shape[-1])]
    return sum(terms[1:], terms[0])


def apply_small(a: Float[Array, "*N I K"], x: Float[Array, "*N K"]) -> Float[Array, "*N I"]:
    """Compute the products `a x` of small matrices and vectors."""
    terms = [a[..., :, k] * x[..., k, None] for k in range(a.shape[-1])]
    return sum(terms[1:], terms[0])


def interpolate_corners(
    shares: Float[Array, "*N K"], corners: Float[Array, "*N K D"]
) -> Float[Array, "*N D"]:
    """Compute weighted sums of a few corners, such as of those of triangles with barycentric coordinates."""
    terms = [shares[..., k, None] * corners[..., k, :] for k in range(shares.shape[-1])]
    return sum(terms[1:], terms[0])
