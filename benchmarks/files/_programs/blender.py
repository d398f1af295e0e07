"""What Blender makes of a file: `python blender.py FILE RATE FRAMES RESULT [AGAIN]`, in an environment that has bpy.

FRAMES are numbers of frames from 0, joined by commas. RESULT (.npz) gets, in the file's axes: `joints (F, J, 3)`, heads of
bones, `turns (F, J, 3, 3)`, how each bone is turned from rest, `names (J,)`, and `vertices (F, V, 3)` where there is a mesh.
AGAIN is a `.glb` that Blender writes of what it has read.
"""

import math
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

#: from Blender's axes, z up, into those of the files, y up
UPRIGHT = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))


def load(path: Path, rate: float) -> tuple[float, float]:
    """Open a file, and return the scene's frame of its first frame, and the step between frames."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, suffix = bpy.context.scene, path.suffix.lower()
    scene.render.fps = round(rate)
    if suffix == ".bvh":
        bpy.ops.import_anim.bvh(filepath=str(path), frame_start=1, global_scale=0.01)
        return 1.0, 1.0
    if suffix == ".glb":
        # keys stand at seconds, and this importer counts in whole frames per second
        bpy.ops.import_scene.gltf(filepath=str(path), merge_vertices=False)
        return 0.0, scene.render.fps / rate
    bpy.ops.wm.usd_import(filepath=str(path), set_frame_range=True)
    return 0.0, 1.0


def main() -> None:
    path, rate, result = Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[4])
    frames = [int(word) for word in sys.argv[3].split(",")]
    first, step = load(path, rate)
    (rig,) = [thing for thing in bpy.context.scene.objects if thing.type == "ARMATURE"]
    meshes = [
        thing
        for thing in bpy.context.scene.objects
        if thing.type == "MESH" and any(modifier.type == "ARMATURE" for modifier in thing.modifiers)
    ]
    bones = list(rig.data.bones)
    rest = {bone.name: rig.matrix_world.to_3x3().normalized() @ bone.matrix_local.to_3x3() for bone in bones}
    joints, turns, vertices = [], [], []
    for frame in frames:
        at = first + step * frame
        bpy.context.scene.frame_set(math.floor(at), subframe=at - math.floor(at))
        graph = bpy.context.evaluated_depsgraph_get()
        posed = rig.evaluated_get(graph)
        world = UPRIGHT @ posed.matrix_world
        joints.append([list(world @ posed.pose.bones[bone.name].head) for bone in bones])
        turned = posed.matrix_world.to_3x3().normalized()
        turns.append(
            [
                turned @ posed.pose.bones[bone.name].matrix.to_3x3().normalized() @ rest[bone.name].inverted()
                for bone in bones
            ]
        )
        if meshes:
            surface = meshes[0].evaluated_get(graph)
            places = np.empty(3 * len(surface.data.vertices), "f4")
            surface.data.vertices.foreach_get("co", places)
            matrix = np.array(UPRIGHT @ surface.matrix_world)
            vertices.append(places.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
    axes = np.array(UPRIGHT.to_3x3())
    found = {
        "names": np.array([bone.name for bone in bones]),
        "joints": np.array(joints),
        "turns": axes @ np.array(turns) @ axes.T,
        "version": np.array(bpy.app.version_string),
    }
    if vertices:
        found["vertices"] = np.array(vertices)
    np.savez(result, **found)
    if len(sys.argv) > 5:
        bpy.ops.export_scene.gltf(filepath=sys.argv[5], export_frame_range=False, export_all_influences=True)


if __name__ == "__main__":
    main()
