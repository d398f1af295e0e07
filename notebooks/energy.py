# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     name: python3
# ---

# %% [markdown]
# # Write your own energy
#
# What a pose is to do is said as a residual of the posed body. It adds up with those of the library, the solver finds the
# pose, and derivatives go through the finding. The page on [energies](../docs/energies.md) says more.

# %%
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Array, Float, Int

import jaxcap as jc
from jaxcap.body.anatomy import rest_deviations
from jaxcap.report.render import draw_surface, frame, turned

VIEW = turned(np.eye(3), 35)
body = jc.human(resolution="low", joints="tracking")
skeleton = body.skeleton
rest = jc.rest_pose(skeleton)

# %% [markdown]
# Two energies of our own: feet that stay on the floor, and a head that looks at a place. Data are fields, the residual is one
# method. It reads what it needs of the posed body; nothing is computed twice, and what no energy reads not at all.

# %%
FLOOR = -0.82


class OnFloor(jc.AbstractEnergy):
    """Height of chosen vertices over the floor, metres."""

    vertices: Int[Array, "C"]

    def residual(self, posed: jc.Posed) -> Float[Array, "C"]:
        return posed.vertices[self.vertices, 1] - FLOOR


class LookAt(jc.AbstractEnergy):
    """How far the head's own direction is from that to a target; no unit."""

    head: int = eqx.field(static=True)
    target: Float[Array, "3"]

    def residual(self, posed: jc.Posed) -> Float[Array, "3"]:
        away = self.target - posed.joints[self.head]
        forward = posed.transforms.rotations[self.head] @ jnp.array([0.0, 0.0, 1.0])
        return forward - away / jnp.linalg.norm(away)


# %% [markdown]
# The right hand reaches for a ball beside the knee, feet stay where they are, the head looks at the ball, and joints would rather
# bend as people's do.

# %%
ball = jnp.array([-0.35, -0.42, 0.45])
soles = jnp.argsort(body.vertices[:, 1])[:40]
hand, head = skeleton.index("RightHand"), skeleton.index("Head")


def wish(ball):
    reach = jc.joint_landmarks(
        jnp.zeros((skeleton.num_joints, 3)).at[hand].set(ball), jnp.eye(skeleton.num_joints)[hand]
    )
    stand = jc.VertexLandmarks(soles, body.vertices[soles], jnp.ones(len(soles)))
    natural = jc.RestPrior(jnp.asarray(rest_deviations(skeleton, 0.5)))
    return 100.0 * reach + 10.0 * stand + 10.0 * OnFloor(soles) + 0.3 * LookAt(head, ball) + 0.01 * natural


solution = jc.solve(wish(ball), body, rest)
print({name: round(float(value), 4) for name, value in solution.energies.items()})
print(f"{int(solution.num_steps)} steps")


# %%
def show(plot, pose, title):
    surface = np.asarray(jc.pose_body(body, pose).vertices, float)
    draw_surface(plot, surface, np.asarray(body.faces), VIEW)
    frame(plot, np.array([-0.7, -0.9]), np.array([0.7, 0.95]), title)
    plot.scatter(*(VIEW @ np.asarray(ball))[:2], s=60, color="#d7263d", zorder=5)


figure, plots = plt.subplots(1, 2, figsize=(6.0, 3.8))
show(plots[0], rest, "rest")
show(plots[1], solution.pose, "reaching, standing, looking")
plt.show()

# %% [markdown]
# ## The same energy, term by term
#
# Weights multiply energies, not residuals. The history of the sum shows the damped steps.

# %%
figure, plot = plt.subplots(figsize=(5.0, 2.4))
plot.semilogy(np.asarray(solution.history), marker="o")
plot.set(xlabel="step", ylabel="E")
plt.show()

# %% [markdown]
# ## Through the solution
#
# How does the elbow's height change as the ball goes up? The implicit function theorem answers without running the solver
# backwards; central differences agree.

# %%
elbow = skeleton.index("RightForeArm")
start = solution.pose


@eqx.filter_jit
def elbow_height(ball):
    pose = jc.solve(wish(ball), body, start).pose
    return jc.pose_body(body, pose).joints[elbow, 1]


slope = jax.grad(elbow_height)(ball)
step = 0.01
around = [
    float(elbow_height(ball.at[axis].add(step)) - elbow_height(ball.at[axis].add(-step))) / (2 * step)
    for axis in range(3)
]
print("implicit   ", np.asarray(slope, float).round(3))
print("differences", np.round(around, 3))

# %% [markdown]
# ## What the energy does not tell
#
# Without the preference for rest, most of the body is held by nothing; the solution says along which of its numbers.

# %%
bare = jc.joint_landmarks(
    jnp.zeros((skeleton.num_joints, 3)).at[hand].set(ball), jnp.eye(skeleton.num_joints)[hand]
)
found = jc.uncertainty(bare, body, solution.pose, variance=0.01**2)
print(f"{int(found.unobservable.sum())} of {len(found.unobservable)} directions are not held by a hand alone")
found = jc.uncertainty(wish(ball), body, solution.pose, variance=0.01**2)
print(jc.describe_unobservable(skeleton, found) or "the whole energy holds all of them")
