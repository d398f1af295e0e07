"""The least-squares problem of a person's build and pose that register the template to a surface."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fit.linear_solvers.dense import DenseMatrix
from ..fit.solvers.descent import ConstrainedInfo
from ..fit.solvers.least_squares_problem import AbstractProblem
from .template import Person, Template, pose_template, prior_deviations, prior_offset, retract_person


class TemplateProblem(AbstractProblem[Person]):
    """A problem that minimises `sum_v x_v' A_v x_v - 2 b_v' x_v + c` plus the prior over persons.

    `x_v` is the shift of vertex `v` from `positions`, its position when the pairs were found. A vertex has any
    number of pairs; their weighted squared distances are summed once into `A_v`, `b_v` and `c`, so that the
    number of rows is that of vertex coordinates.
    """

    template: Template
    positions: Float[Array, "V 3"]
    matrices: Float[Array, "V 3 3"]
    vectors: Float[Array, "V 3"]
    #: `c`, the energy of the pairs at `positions`
    constant: Float[Array, ""]
    #: the mean of the prior on the logarithm of the size
    mean_log_size: Float[Array, ""]

    def value(self, y: Person):
        x = pose_template(self.template, y).vertices - self.positions
        pulled = jnp.einsum("vab,vb->va", self.matrices, x)
        offset = prior_offset(self.template, y, self.mean_log_size) / self.scales()
        return 0.5 * (jnp.sum(x * (pulled - 2.0 * self.vectors)) + self.constant + offset @ offset)

    def information(self, y: Person):
        scales = self.scales()

        def vertices(d):
            return pose_template(self.template, self.retract(y, scales * d)).vertices

        jacobian = jax.jacfwd(vertices)(jnp.zeros_like(scales))
        pulled = jnp.einsum("vab,vbx->vax", self.matrices, jacobian)
        slopes = (
            jnp.einsum("vab,vb->va", self.matrices, vertices(jnp.zeros_like(scales)) - self.positions)
            - self.vectors
        )
        # the offset's Jacobian is taken as the identity, as near rest; the root, without prior, is damped
        # alike
        offset = prior_offset(self.template, y, self.mean_log_size) / scales
        gradient = jnp.einsum("vax,va->x", jacobian, slopes) + offset
        matrix = jnp.einsum("vax,vay->xy", jacobian, pulled) + jnp.eye(len(scales), dtype=scales.dtype)
        return ConstrainedInfo(self.value(y), gradient, DenseMatrix(matrix))  # pyright: ignore[reportCallIssue]

    def retract(self, y: Person, d: Float[Array, "X"]):
        return retract_person(self.template, y, d)

    def scales(self):
        return jnp.asarray(prior_deviations(self.template), self.matrices.dtype)
