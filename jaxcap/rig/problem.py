"""The least-squares problem of a person's build and pose that register the template to a surface."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..fit.linear.dense import Dense
from ..fit.solvers.descent import ConstrainedInfo
from ..fit.solvers.problem import AbstractProblem
from .template import Person, Template, move, pose_template, prior_offset, prior_spreads


class TemplateProblem(AbstractProblem[Person]):
    """A problem that minimises `sum_v x_v' A_v x_v - 2 b_v' x_v + c` plus the prior over persons.

    `x_v` is the shift of vertex `v` from `places`, its position when the pairs were found. A vertex has any
    number of pairs; their weighted squared distances are summed once into `A_v`, `b_v` and `c`, so that the
    number of rows is that of vertex coordinates.
    """

    template: Template
    places: Float[Array, "V 3"]
    matrices: Float[Array, "V 3 3"]
    pulls: Float[Array, "V 3"]
    #: `c`, the energy of the pairs at `places`
    worth: Float[Array, ""]
    #: the mean of the prior on the logarithm of the size
    size: Float[Array, ""]

    def value(self, y: Person):
        x = pose_template(self.template, y).vertices - self.places
        pulled = jnp.einsum("vab,vb->va", self.matrices, x)
        offset = prior_offset(self.template, y, self.size) / self.scales()
        return 0.5 * (jnp.sum(x * (pulled - 2.0 * self.pulls)) + self.worth + offset @ offset)

    def information(self, y: Person):
        scales = self.scales()

        def vertices(d):
            return pose_template(self.template, self.retract(y, scales * d)).vertices

        jacobian = jax.jacfwd(vertices)(jnp.zeros_like(scales))
        pulled = jnp.einsum("vab,vbx->vax", self.matrices, jacobian)
        slopes = (
            jnp.einsum("vab,vb->va", self.matrices, vertices(jnp.zeros_like(scales)) - self.places)
            - self.pulls
        )
        # the offset's Jacobian is taken as the identity, as near rest; the root, without prior, is damped
        # alike
        offset = prior_offset(self.template, y, self.size) / scales
        gradient = jnp.einsum("vax,va->x", jacobian, slopes) + offset
        matrix = jnp.einsum("vax,vay->xy", jacobian, pulled) + jnp.eye(len(scales), dtype=scales.dtype)
        return ConstrainedInfo(self.value(y), gradient, Dense(matrix))  # pyright: ignore[reportCallIssue]

    def retract(self, y: Person, d: Float[Array, "X"]):
        return move(self.template, y, d)

    def scales(self):
        return jnp.asarray(prior_spreads(self.template), self.matrices.dtype)
