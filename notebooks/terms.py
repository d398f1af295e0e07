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
# # One term in every fit
#
# A term of your own is written once, and given to tracking, to fits to registered meshes, to learning, to adaptation and to fits to markers.
# The page on [energies](../docs/energies.md#a-term-in-every-fit) says on what it acts in each of them.

# %%
import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Array, Float

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.report.plots import BLUE, RED, style_chart

# %% [markdown]
# The term: no vertex is below a height. The residual is in standard deviations of 5 mm, and does not depend on the number of vertices, so that
# one class serves bodies with any surface, and markers.


# %%
class AboveFloor(jc.AbstractEnergy):
    """Depth of vertices below a height, in standard deviations of 5 mm."""

    height: Float[Array, ""]

    def residual(self, posed: jc.body.Posed) -> Float[Array, "V"]:
        return jnp.minimum(posed.vertices[:, 1] - self.height, 0.0) / 0.005


# %% [markdown]
# The data: the embedded human walks on the spot. Everything that was measured within 15 cm of the floor is 3 cm too low, as after a poor
# calibration.

# %%
body = jc.human(resolution="low", joints="tracking")
motion = walk_and_wave(body.skeleton, seconds=2.0).slice(slice(0, 60, 10))
faces = np.asarray(body.faces)
true = np.asarray(posed_vertices(body, motion.poses), float)
FLOOR = float(true[..., 1].min())


def too_low(points: np.ndarray) -> np.ndarray:
    return points - 0.03 * np.clip(1.5 - (points[..., 1:2] - FLOOR) / 0.1, 0, 1) * [0.0, 1.0, 0.0]


meshes = jc.MeshSequence(too_low(true), faces, motion.rate)
normals = [np.asarray(jc.pose_body(body, pose).normals, float) for pose in motion]
clouds = [jc.make_cloud(too_low(points), normal) for points, normal in zip(true, normals, strict=True)]

bones = np.asarray(body.skin.dominant_bones())
chosen = np.arange(0, len(bones), 12)
subject = jc.markers.make_subject(
    body.skeleton, bones[chosen], np.asarray(body.vertices)[chosen], [f"m{number}" for number in chosen]
)
marked = np.asarray(eqx.filter_jit(jax.vmap(jc.markers.marker_positions, (None, 0)))(subject, motion.poses))
frames = jc.make_markers(too_low(marked), subject.labels, rate=motion.rate)

# %% [markdown]
# Every fit runs without and with the term. Its weight is relative to the data: a weight of 100 makes the standard deviation
# 0.5 mm instead of 5 mm, so that many points do not outvote the floor.

# %%
floor = 100.0 * AboveFloor(jnp.asarray(FLOOR))


def lowest(body: jc.Body, motion: jc.Motion) -> float:
    return 1000 * (float(posed_vertices(body, motion.poses)[..., 1].min()) - FLOOR)


def lowest_marker(subject, motion: jc.Motion) -> float:
    found = jax.vmap(jc.markers.marker_positions, (None, 0))(subject, motion.poses)
    return 1000 * (float(found[..., 1].min()) - FLOOR)


def adapted(terms) -> float:
    settings = jc.adapt.AdaptSettings(num_frames=4, proportion_rounds=2, rounds=(1,), temporal_weight=0.0)
    task = jc.make_adapt_task(body, clouds, start=motion[0], settings=settings, terms=terms)
    *_, state = jc.adapt_body(task)
    return lowest(state.body, state.motion)


def tracked(terms) -> float:
    return lowest(body, jc.track(body, clouds, motion[0], search=False, terms=terms))


def learned(terms) -> float:
    found = jc.learn_body(meshes, rounds=1, terms=terms)
    return lowest(found.body, found.motion)


def calibrated(terms) -> float:
    found = jc.markers.calibrate(frames, subject, num_frames=len(frames), skin=False, terms=terms)
    return lowest_marker(found.subject, found.motion)


fits = {
    "track": tracked,
    "fit_meshes": lambda terms: lowest(body, jc.fit_meshes(body, meshes, terms=terms).motion),
    "learn_body": learned,
    "adapt_body": adapted,
    "solve_markers": lambda terms: lowest_marker(
        subject, jc.markers.solve_markers(subject, frames, terms=terms).motion
    ),
    "calibrate": calibrated,
}
depths = {name: (fit(()), fit([floor])) for name, fit in fits.items()}
for name, (without, within) in depths.items():
    print(f"{name}: lowest point {without:.0f} mm without the term, {within:.0f} mm with it")
print(
    "every fit is higher with the term:", all(within > 0.5 * without for without, within in depths.values())
)

# %%
figure, plot = plt.subplots(figsize=(7.0, 2.8))
rows = np.arange(len(depths))
for shift, part, colour, label in ((-0.2, 0, RED, "without the term"), (0.2, 1, BLUE, "with it")):
    plot.barh(rows + shift, [pair[part] for pair in depths.values()], 0.38, color=colour, label=label)
plot.set_yticks(rows, list(depths))
plot.invert_yaxis()
plot.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
style_chart(plot, "One term keeps the feet above the floor in six fits", "lowest point above the floor, mm")
plt.show()
