# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
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
import trimesh
from jaxtyping import Array, Float

import jaxcap as jc
from jaxcap.body.people.anatomy import rest_deviations
from jaxcap.report.plots import BLUE, draw_person, frame_together, label_point, style_chart
from jaxcap.report.render import raise_view, rotate_view

VIEW = raise_view(rotate_view(np.eye(3), 40.0), 10.0)
body = jc.human(resolution="low", joints="tracking")
skeleton = body.skeleton
rest = jc.rest_pose(skeleton)

# %% [markdown]
# Two energies of our own: balance, so that the middle of the body stays over the feet, and a head that looks at a place. Data are
# fields, the residual is one method. It reads what it needs of the posed body; nothing is computed twice, and what no energy reads
# not at all.


# %%
class Balance(jc.AbstractEnergy):
    """How far the middle of the body is from being above a place, metres along x and z."""

    above: Float[Array, "3"]

    def residual(self, posed: jc.body.Posed) -> Float[Array, "2"]:
        return (posed.vertices.mean(0) - self.above)[jnp.array([0, 2])]


class LookAt(jc.AbstractEnergy):
    """How far the head's own direction is from that to a target; no unit."""

    head: int = eqx.field(static=True)
    target: Float[Array, "3"]

    def residual(self, posed: jc.body.Posed) -> Float[Array, "3"]:
        away = self.target - posed.joints[self.head]
        forward = posed.transforms.rotations[self.head] @ jnp.array([0.0, 0.0, 1.0])
        return forward - away / jnp.linalg.norm(away)


# %% [markdown]
# The right hand reaches for a ball in front of the hip, both soles stay where they are, the body stays above them, the head looks at
# the ball, and joints would rather bend as people's do.

# %%
ball = jnp.array([-0.28, 0.03, 0.52])
FLOOR = float(body.vertices[:, 1].min())
soles = jnp.flatnonzero(body.vertices[:, 1] < FLOOR + 0.02)
feet = body.vertices[soles]
hand, head = skeleton.index("RightHand"), skeleton.index("Head")


def wish(ball):
    reach = jc.energy.joint_landmarks(
        jnp.zeros((skeleton.num_joints, 3)).at[hand].set(ball), jnp.eye(skeleton.num_joints)[hand]
    )
    stand = jc.VertexLandmarks(soles, feet, jnp.ones(len(soles)))
    balance = Balance(feet.mean(0))
    natural = jc.RestPrior(jnp.asarray(rest_deviations(skeleton, 0.5)))
    return 100.0 * reach + 10.0 * stand + 50.0 * balance + 0.1 * LookAt(head, ball) + 0.01 * natural


solution = jc.solve(wish(ball), body, rest)
print({name: round(float(value), 4) for name, value in solution.energies.items()})
print(f"{int(solution.num_steps)} steps")


# %%
def show(plot, pose):
    surface = np.asarray(jc.pose_body(body, pose).vertices, float)
    faces = np.asarray(body.faces)
    seen = draw_person(plot, surface, faces, VIEW, floor=FLOOR)
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    draw_person(
        plot, sphere.vertices + np.asarray(ball), sphere.faces, VIEW, np.array([0.84, 0.2, 0.26]), FLOOR
    )
    return seen


figure, plots = plt.subplots(1, 2, figsize=(7.0, 4.6))
figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.93, wspace=0.0)
seen = [show(plot, pose) for plot, pose in zip(plots, (rest, solution.pose), strict=True)]
frame_together(plots, seen, ["at rest", "reaching for the ball, standing, looking at it"])
plt.show()

# %% [markdown]
# ## The same energy, term by term
#
# Weights multiply energies, not residuals. The history of the sum shows the damped steps.

# %%
history = np.asarray(solution.history)
history = history[np.isfinite(history)]
figure, plot = plt.subplots(figsize=(7.0, 2.8))
plot.semilogy(history, color=BLUE, marker="o", ms=4)
style_chart(plot, "Every step lowers the energy; most of it goes in the first ones", "step", "E")
label_point(plot, f"{history[0]:.3g}", (0, history[0]), BLUE)
label_point(plot, f"{history[-1]:.3g}", (len(history) - 1, history[-1]), BLUE, xytext=(0, 7), ha="right")
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
# A hand alone leaves most of the body free. The whole energy holds more of it; what its faint preference for rest alone holds is
# lost in the rounding of single precision, and counts as not held. The solution says along which of its numbers.

# %%
bare = jc.energy.joint_landmarks(
    jnp.zeros((skeleton.num_joints, 3)).at[hand].set(ball), jnp.eye(skeleton.num_joints)[hand]
)
found = jc.uncertainty(bare, body, solution.pose, variance=0.01**2)
whole = jc.uncertainty(wish(ball), body, solution.pose, variance=0.01**2)
free, total = int(found.unobservable.sum()), len(found.unobservable)
print(
    f"of {total} directions a hand alone leaves {free} free, the whole energy {int(whole.unobservable.sum())}"
)
print(*jc.fit.describe_unobservable(skeleton, whole), sep="\n")
