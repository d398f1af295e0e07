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
# # From a depth camera to a motion
#
# One depth camera sees one side of a person in a room. The page on [depth images](../docs/depth.md) describes the steps.

# %%
import matplotlib.pyplot as plt
import numpy as np

import jaxcap as jc
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.metrics import joint_errors
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth
from jaxcap.scanner.scan import scan_scene

# %% [markdown]
# ## The images
#
# A woman of 1.60 m walks on the spot and waves in front of a simulated Azure Kinect, in a room with a floor, walls, a table
# and a chair. For images of your own, `read_depths` opens a folder, and `read_cameras` the intrinsics.

# %%
person = jc.human(sex="female", height=1.6, weight=0.3, resolution="medium")
performance = walk_and_wave(person.skeleton, seconds=1.0)
posed = [jc.pose_body(person, performance[number]) for number in range(0, performance.num_frames, 2)]
surfaces = [np.asarray(one.vertices, float) for one in posed]
low = np.min([surface.min(0) for surface in surfaces], 0)
high = np.max([surface.max(0) for surface in surfaces], 0)
room, sensor = jc.scanner.make_room(low, high), jc.scanner.SENSORS["azure-kinect"]
camera = jc.geometry.look_at(
    [0.3, low[1] + 1.3, 2.4], [0.0, low[1] + 0.9, 0.0], *sensor.resolution, sensor.field_of_view
)
images = [
    scan_scene(
        sensor.errors,
        [camera],
        [(surface, np.asarray(person.faces)), (room.vertices, room.faces)],
        frame=number,
    )[0].depth
    for number, surface in enumerate(surfaces)
]
len(images), images[0].shape

# %% [markdown]
# ## The person
#
# `find_person` removes planes, such as floor and walls, and takes the nearest connected surface with the size of a person.

# %%
masks = [jc.depth.find_person(camera, image) for image in images]
figure, plots = plt.subplots(1, 3, figsize=(9.0, 3.2), constrained_layout=True)
for plot, number in zip(plots, (0, 7, 14), strict=True):
    shown = np.where(images[number] > 0, images[number], np.nan)
    plot.imshow(shown, cmap="Greys", vmin=1.0, vmax=5.0)
    plot.imshow(np.where(masks[number], shown, np.nan), cmap="viridis_r", vmin=1.9, vmax=2.8)
    plot.set_title(f"image {number}; the person in colour", fontsize=9)
    plot.axis("off")
plt.show()

# %% [markdown]
# ## The clouds
#
# A cloud of a depth image also contains the image, so that a fit keeps the body out of space that the camera saw empty.

# %%
clouds = [
    jc.depth.cloud_of_depths([camera], [image], [mask]) for image, mask in zip(images, masks, strict=True)
]
[len(cloud.points) for cloud in clouds[:3]], len(clouds[0].views)

# %% [markdown]
# ## The shape of the person
#
# `partial=True` adds the prior of people's poses and self-collision. `estimate_shape` fits the build of the human to some
# frames, together with their poses. `search=False` starts at rest; without it the first pose is searched for.

# %%
human = jc.human(resolution="low", joints="tracking")
body = jc.adapt.estimate_shape(jc.make_tracker(human, partial=True), clouds, num_frames=4, search=False)
heights = [np.ptp(np.asarray(one.vertices)[:, 1]) for one in (human, body, person)]
print("height of the human {:.2f} m, estimated {:.2f} m, true {:.2f} m".format(*heights))

# %% [markdown]
# ## The motion

# %%
tracker = jc.make_tracker(body, partial=True)
frames = list(jc.fit.track_frames(tracker, clouds, search=False))
[frame.verdict for frame in frames].count("good"), len(frames)

# %% [markdown]
# The outline of the body in the images, and the errors of its joints. Joints that the camera does not see are a guess.

# %%
figure, plots = plt.subplots(1, 3, figsize=(9.0, 3.2), constrained_layout=True)
for plot, number in zip(plots, (0, 7, 14), strict=True):
    surface = np.asarray(jc.pose_body(body, frames[number].pose).vertices, float)
    fitted = render_depth(camera, make_ray_mesh(surface, np.asarray(body.faces))).depth > 0
    plot.imshow(np.where(masks[number], images[number], np.nan), cmap="viridis_r", vmin=1.9, vmax=2.8)
    plot.contour(fitted, levels=[0.5], colors="#c2410c", linewidths=1.0)
    plot.set_title(f"frame {number}", fontsize=9)
    plot.axis("off")
plt.show()

# %%
found = np.array([jc.pose_body(body, frame.pose).joints for frame in frames])
true = np.array([one.joints for one in posed])
names = [name for name in body.skeleton.names if name in person.skeleton.names]
columns = [[one.skeleton.index(name) for name in names] for one in (body, person)]
errors = 1000 * joint_errors(found[:, columns[0]], true[:, columns[1]])
print(f"joints: mean {errors.mean():.0f} mm, 90 % within {np.quantile(errors, 0.9):.0f} mm")
