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
# # From scans to the parameters of your body model
#
# Scans of a person, without landmarks and without a first pose, become coefficients (`betas`) and poses of a model in SMPL's format,
# and then an animated body in Blender. The page on [body models](../docs/body_models.md) describes which models are read.

# %%
import tempfile
from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxcap as jc
from jaxcap.body.people.random_humans import sample_humans
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.edit.retargeting.retarget import retarget
from jaxcap.metrics import joint_errors, scan_to_surface
from jaxcap.report.plots import distance_bar, draw_person, draw_scan, frame_together

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## The model
#
# The files of SMPL, SMPL-H and SMPL-X have licences that do not allow to share them. If you have one, give its path below, such as
# `SMPLX_NEUTRAL.npz`. The model here has the same format, and is made from the embedded human: the mean of 60 people, their
# principal components as shape directions, and 24 joints with the names and the order of SMPL.

# %%
PLACES = [
    "Hips",
    "LeftUpLeg",
    "RightUpLeg",
    "LowerBack",
    "LeftLeg",
    "RightLeg",
    "Spine",
    "LeftFoot",
    "RightFoot",
    "Spine1",
    "LeftToeBase",
    "RightToeBase",
    "Neck",
    "LeftShoulder",
    "RightShoulder",
    "Head",
    "LeftArm",
    "RightArm",
    "LeftForeArm",
    "RightForeArm",
    "LeftHand",
    "RightHand",
    "LeftFingerBase",
    "RightFingerBase",
]
PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
MERGED = {"LHipJoint": "Hips", "RHipJoint": "Hips", "Neck1": "Neck", "LThumb": "LeftHand", "RThumb": "RightHand",
          "LeftHandFinger1": "LeftFingerBase", "RightHandFinger1": "RightFingerBase"}  # fmt: skip


def write_model(path, num_betas=10):
    people = sample_humans(60, resolution="low", joints="tracking")
    surfaces = np.array([np.asarray(body.vertices, float) for body in people])
    mean = surfaces.mean(0)
    _, sizes, axes = np.linalg.svd((surfaces - mean).reshape(len(people), -1), full_matrices=False)
    directions = axes[:num_betas] * sizes[:num_betas, None] / np.sqrt(len(people) - 1)
    skeleton = people[0].skeleton
    regressor = np.zeros((24, len(mean)))
    for joint, name in enumerate(PLACES):
        places = np.array([np.asarray(body.skeleton.centres[skeleton.index(name)], float) for body in people])
        near = np.argsort(np.linalg.norm(surfaces - places[:, None], axis=2).mean(0))[:150]
        rows = np.concatenate(
            [surfaces[:, near].transpose(0, 2, 1).reshape(-1, 150), 100 * np.ones((1, 150))]
        )
        regressor[joint, near] = np.linalg.lstsq(rows, np.append(places.ravel(), 100), rcond=1e-3)[0]
    bones = np.asarray(people[0].skin.bone_weights(skeleton.num_joints), float)
    weights = np.zeros((len(mean), 24))
    for joint, name in enumerate(skeleton.names):
        weights[:, PLACES.index(MERGED.get(name, name))] += bones[:, joint]
    np.savez(
        path,
        v_template=mean,
        shapedirs=np.moveaxis(directions.reshape(num_betas, -1, 3), 0, 2),
        posedirs=np.zeros((len(mean), 3, 207)),
        J_regressor=regressor / regressor.sum(1, keepdims=True),
        weights=weights / weights.sum(1, keepdims=True),
        kintree_table=np.array([[2**32 - 1, *PARENTS[1:]], range(24)], dtype=np.uint32),
        f=np.asarray(people[0].faces).astype(np.uint32),
    )
    return path


path = write_model(folder / "smpl_made.npz")
model = jc.read_body_model(path, joints="tracking")
print(
    f"{model.family}: {len(model.template.vertices)} vertices, {model.template.skeleton.num_joints} joints, {dict(model.groups)}"
)

# %% [markdown]
# ## The scans
#
# A person of the model walks and waves in front of four simulated cameras with 2 mm of noise. For scans of your own, `read_clouds`
# reads them.

# %%
betas = np.array([1.2, -0.8, 0.7, 0.5, -0.9, 0.3, 0.6, -0.4, 0.2, -0.3])
person = jc.shape_body(model, betas=betas)
human = jc.human(resolution="low").skeleton
motion = retarget(walk_and_wave(human, seconds=2.0), human, person.skeleton).slice(slice(10, 60, 5))
truth = [jc.pose_body(person, motion[frame]) for frame in range(len(motion))]
cameras = jc.geometry.ring_of_cameras(4, 360, 2.6, 0.4, [0.0, 0.0, 0.0], (200, 200))
scanner = jc.scanner.Scanner(noise=0.002, points=3000)
scans = [
    jc.scanner.scan_frame(
        scanner, cameras, np.asarray(one.vertices, float), np.asarray(person.faces), frame=frame
    )
    for frame, one in enumerate(truth)
]
clouds = [jc.make_cloud(scan.points, scan.normals) for scan in scans]
len(clouds), len(scans[0].points)

# %% [markdown]
# ## Coefficients, then poses
#
# `estimate_shape` searches for the first pose, tracks the clouds with the template, and fits the coefficients to some frames together
# with their poses. The command is `jaxcap track smpl_made.npz "scans/*.ply" --fit-shape -o out`.

# %%
tracker = jc.make_tracker(model.template)
body = jc.adapt.estimate_shape(tracker, clouds, model)
frames = list(jc.fit.track_frames(jc.make_tracker(body), clouds))
print("verdicts:", {frame.verdict for frame in frames})

# %%
found = np.asarray(jc.body.body_coefficients(model, body), float)
poses = jc.stack_poses([frame.pose for frame in frames], rate=6.0)
posed = [jc.pose_body(body, poses[frame]) for frame in range(len(frames))]
surface = [
    scan_to_surface(
        np.asarray(there.vertices, float), np.asarray(here.vertices, float), np.asarray(body.faces)
    )
    for there, here in zip(truth, posed, strict=True)
]
joints = joint_errors(*(np.array([np.asarray(one.joints, float) for one in of]) for of in (posed, truth)))
print("betas, true: ", np.round(betas, 1))
print("betas, found:", np.round(found, 1))
print(f"surface {1000 * np.median(surface):.1f} mm (median), joints {1000 * joints.mean():.1f} mm (mean)")

# %%
figure, plots = plt.subplots(1, 4, figsize=(9.0, 4.2))
figure.subplots_adjust(left=0.0, right=1.0, top=0.92, wspace=0.0)
seen, faces = [], np.asarray(body.faces)
# all on one floor
rows = [
    (model.template.vertices, None),
    (body.vertices, None),
    *((posed[k].vertices, scans[k]) for k in (0, 6)),
]
for plot, (vertices, scan) in zip(plots, rows, strict=True):
    floor = [0.0, float(vertices[:, 1].min()), 0.0]
    placed = np.asarray(vertices, float) - floor
    seen.append(draw_person(plot, placed, faces))
    if scan is not None:
        draw_scan(plot, scan.points - floor, placed, faces, far=0.02)
frame_together(plots, seen, ["the template", "the person", "scan 0 on the body", "scan 6 on the body"])
distance_bar(figure, 0.02)
plt.show()

# %% [markdown]
# ## Parameters for other programs
#
# The format is that of AMASS: `poses`, `trans`, `betas`, `gender` and the rate. Every program that reads AMASS's files reads it.

# %%
jc.io.write_amass(folder / "fit.npz", body.skeleton, poses, {"betas": found}, up="y")
with np.load(folder / "fit.npz") as file:
    print({name: file[name].shape or file[name].item() for name in file.files})

# %% [markdown]
# Read back, the model with these parameters has the surface that was fitted.

# %%
shape, gender = jc.io.read_amass_shape(folder / "fit.npz")
again = jc.shape_body(model, betas=jnp.asarray(shape["betas"]))
_, read = jc.io.read_amass(folder / "fit.npz", again.skeleton)
gap = jc.pose_body(again, read[3]).vertices - posed[3].vertices
print(f"{gender}; vertices differ by at most {1e6 * float(jnp.abs(gap).max()):.1f} micrometres")

# %% [markdown]
# ## Blender
#
# glTF has the skeleton, the skin and the motion. The command is `jaxcap convert fit.npz person.glb --body smpl_made.npz`.

# %%
linear = jc.edit.to_linear_blend(body, poses.poses)
jc.write_gltf(folder / "person.glb", linear.body, jc.edit.linear_motion(linear, poses))
print(f"person.glb: {(folder / 'person.glb').stat().st_size / 1e6:.1f} MB")

# %% [markdown]
# In Blender, or in a script for `blender --background --python script.py`:
#
# ```
# import bpy
#
# bpy.context.scene.render.fps = 6
# bpy.ops.import_scene.gltf(filepath="person.glb")
# ```
