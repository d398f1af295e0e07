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
# # Derivatives, three ways
#
# The same derivative by automatic differentiation, by central differences, and by the closed forms of the Kineben paper
# (equations 8 to 16). `python -m benchmarks.gradients` holds them together over more bodies and poses; the page on
# [the paper](../docs/papers/kineben.md) has its equations and their functions. In float64, so that differences are worth something.

# %%
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxcap as jc
from jaxcap.body.kinematics import world_axes
from jaxcap.body.skeleton import dof_layout
from jaxcap.fit.linearise import vertex_jacobian
from jaxcap.geometry import rotation
from jaxcap.report.plots import BLUE, GREEN, RED, label_point, style_chart

# %% [markdown]
# A chain with every kind of joint, and a surface of a few hundred points around it, each fixed to a bone.

# %%
NAMES = ("root", "slide", "knee", "hip", "wrist")
KINDS = ("free", "translate", "revolute", "ball", "universal")
CENTRES = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.4, 0.05, 0], [0.6, 0, 0.05], [0.8, 0, 0]])
skeleton = jc.make_skeleton(NAMES, (-1, 0, 1, 2, 3), KINDS, centres=CENTRES)
layout = dof_layout(skeleton)
rng = np.random.default_rng(0)
bones = jnp.asarray(np.repeat(np.arange(5), 60))
vertices = jnp.asarray(CENTRES[bones] + [0.1, 0, 0] + 0.06 * rng.normal(size=(300, 3)))
faces = jnp.asarray(np.arange(300).reshape(-1, 3))
body = jc.Body(skeleton, jc.body.RigidSkin(bones), vertices, faces)
pose = jc.retract(skeleton, jc.rest_pose(skeleton), jnp.asarray(0.7 * rng.normal(size=skeleton.num_dofs)))
layout.names

# %% [markdown]
# **Automatic**: forward mode through `retract`, kinematics and skin.


# %%
def moved(d):
    return jc.pose_body(body, jc.retract(skeleton, pose, d)).vertices


autodiff = jax.jit(jax.jacfwd(moved))(jnp.zeros(skeleton.num_dofs))

# %% [markdown]
# **Closed form**: `vertex_jacobian`, which tracking uses by way of the skin, and the paper's own 4 x 4 operators, one joint's number
# after the other: eq. 8 for what slides, eq. 10 for what turns about an axis, eqs. 12 and 13 for a ball joint's update.

# %%
posed = eqx.filter_jit(jc.pose_body)(body, pose)
closed = eqx.filter_jit(vertex_jacobian)(posed)


def translate_operator(axis):
    """Differentiate points under a translation along the world axis (eq. 8)."""
    return np.pad(np.asarray(axis)[:, None], ((0, 1), (3, 0)))


def revolute_operator(axis, centre):
    """Differentiate points under a rotation about the world axis through the centre of a joint (eq. 10)."""
    columns = np.concatenate([np.cross(axis, np.eye(3)), -np.cross(axis, centre)[None]]).T
    return np.pad(columns, ((0, 1), (0, 0)))


def ball_operator(turn, centre, number):
    """Differentiate points under one number of a ball joint's update, about a column of its rotation (eqs. 12, 13)."""
    return revolute_operator(turn[:, number], centre)


points = np.concatenate([posed.vertices, np.ones((300, 1))], 1)
shifts, turns = world_axes(skeleton, pose, posed.transforms)
paper = np.zeros(autodiff.shape)
for joint, kind in enumerate(KINDS):
    rides = skeleton.descendants[joint][np.asarray(bones)][:, None]
    for number in range(3):
        slot = layout.translations[joint, number]
        if slot < skeleton.num_dofs:
            paper[:, :, slot] = rides * (points @ translate_operator(shifts[joint, number]).T)[:, :3]
        slot = layout.rotations[joint, number]
        if slot < skeleton.num_dofs:
            centre = posed.joints[joint]
            if kind in ("ball", "free"):
                operator = ball_operator(posed.transforms.rotations[joint], centre, number)
            else:
                operator = revolute_operator(turns[joint, number], centre)
            paper[:, :, slot] = rides * (points @ operator.T)[:, :3]

print(f"closed form against autodiff: {np.abs(closed - autodiff).max():.1e}")
print(f"the paper's operators against autodiff: {np.abs(paper - autodiff).max():.1e}")

# %% [markdown]
# **Differences**, over a range of steps, in both precisions. Too long a step errs by curvature, too short a one by rounding; the
# derivatives above have neither.


# %%
@partial(jax.jit, static_argnums=1)
def difference(step, dtype):
    steps = step * jnp.eye(skeleton.num_dofs)
    slope = lambda e: (moved(e).astype(dtype) - moved(-e).astype(dtype)).astype(float) / (2 * step)  # noqa: E731
    return jnp.moveaxis(jax.lax.map(slope, steps), 0, -1)


steps = np.logspace(-9, -0.5, 24)
figure, plot = plt.subplots(figsize=(7.0, 3.6))
for dtype, colour in ((jnp.float64, BLUE), (jnp.float32, RED)):
    errors = [float(jnp.abs(difference(step, dtype) - autodiff).max()) for step in steps]
    plot.loglog(steps, errors, marker="o", ms=3.5, color=colour)
    label_point(
        plot, f"differences, places in {dtype.__name__}", (steps[2], errors[2]), colour, xytext=(4, 8)
    )
exact = max(float(np.abs(closed - autodiff).max()), 1e-17)
plot.axhline(exact, color=GREEN, linewidth=2)
label_point(plot, "closed form, no step at all", (steps[0], exact), GREEN, xytext=(0, 6))
plot.set_ylim(exact / 30, 1e3)
style_chart(
    plot, "No step is right for differences: too long bends, too short rounds", "step, metres and radians",
    "largest distance from autodiff",
)  # fmt: skip
plt.show()

# %% [markdown]
# ## A cone, and the sign of equation 16
#
# A ball joint may turn an axis only so far; the paper's gradient of that is `x_B x R^T x_B`.


# %%
def cosine(d, axis, q):
    return axis @ rotation.rotate(rotation.multiply(q, rotation.exp(d)), axis)


def cone_gradient(axis, turn):
    """Compute the gradient of a cone's cosine by the joint's update (eq. 16)."""
    return jnp.cross(axis, turn.T @ axis)


axis = jnp.array([0.0, -1.0, 0.0])
q = rotation.exp(jnp.array([0.4, 0.2, -0.7]))
print("eq. 16   ", np.asarray(cone_gradient(axis, rotation.to_matrix(q))).round(6))
print("autodiff ", np.asarray(jax.grad(cosine)(jnp.zeros(3), axis, q)).round(6))

# %% [markdown]
# ## Where formulas divide by nothing
#
# At rest an axis of turn does not exist, and at half a turn it has two. Derivatives stay finite and right at both.

# %%
for name, angle in (("rest", 0.0), ("next to rest", 1e-12), ("half a turn, nearly", np.pi - 1e-9)):
    r = angle * jnp.array([0.6, 0.0, 0.8])
    there_and_back = jax.jacfwd(lambda w: rotation.log(rotation.exp(w)))(r)
    print(f"{name}: {np.abs(np.asarray(there_and_back) - np.eye(3)).max():.1e} from the identity")
