"""Exports as Blender imports them, against the true vertices of every frame.

Usage: blender --background --factory-startup --python check-blender.py -- FOLDER [PICTURE_FOLDER]
FOLDER holds frames.glb, expressions.glb, cache.pc2, cache.mdd, cache.obj (of which some may be missing), and the truth:
truth/frame_%06d.f32 and coarse/frame_%06d.f32 (for expressions.glb), [vertex_count][3] metres, x right, y up, z towards the viewer.
With PICTURE_FOLDER every import is rendered too. Prints what it compared; exit status 1 where something is off.
"""
import pathlib
import sys

import bpy
import numpy as np

RATE_HZ = 30
folder, *pictures = [pathlib.Path(argument) for argument in sys.argv[sys.argv.index("--") + 1:]]
failures = []


def truth(name):
    return {int(file.stem[6:]): np.fromfile(file, np.float32).reshape(-1, 3) for file in sorted((folder / name).glob("*.f32"))}


def empty_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = RATE_HZ
    bpy.context.scene.frame_start = 0


def vertices(frame):
    """The one mesh as it stands at a frame: world space, turned from Blender's z up to y up."""
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    meshes = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    assert len(meshes) == 1, f"{len(meshes)} meshes"
    evaluated = meshes[0].evaluated_get(graph)
    mesh = evaluated.to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    matrix = np.array(evaluated.matrix_world)
    evaluated.to_mesh_clear()
    world = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return np.stack([world[:, 0], world[:, 2], -world[:, 1]], axis=1)


def compare(name, expected, frame_of, tolerance_m):
    worst = 0.0
    for number, points in expected.items():
        found = vertices(frame_of(number))
        if found.shape != points.shape:
            failures.append(f"{name}: frame {number} has {len(found)} vertices, not {len(points)}")
            return
        worst = max(worst, float(np.abs(found - points).max()))
    print(f"{name}: {len(expected)} frames of {len(points)} vertices, at most {1e6 * worst:.2f} um off")
    if not worst < tolerance_m:
        failures.append(f"{name}: vertices are up to {1e3 * worst:.4f} mm off")
    if pictures:
        render(name, points)


def render(name, points):
    """A picture of the last frame from where the camera stood."""
    scene = bpy.context.scene
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = 1.1 * float((points.max(axis=0) - points.min(axis=0)).max())
    camera.location = (centre[0], -(centre[2] + 1), centre[1])
    camera.rotation_euler = (np.pi / 2, 0, 0)
    light = bpy.data.objects.new("light", bpy.data.lights.new("light", "SUN"))
    light.rotation_euler = (0.9, 0.4, 0)
    light.data.energy = 3
    scene.collection.objects.link(light)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 8
    scene.cycles.device = "CPU"
    scene.cycles.use_denoising = False
    scene.render.resolution_x = scene.render.resolution_y = 400
    scene.render.filepath = str(pictures[0] / f"{name}.png")
    bpy.ops.render.render(write_still=True)


finest = truth("truth")
first = min(finest)
for file in ("frames.glb", "expressions.glb"):
    if (folder / file).exists():
        empty_scene()
        # As docs/exports.md says: Debian 12's Blender 3.4 takes "Use Normal Data" by a name that its NumPy 1.24 has no more.
        bpy.ops.import_scene.gltf(filepath=str(folder / file), import_shading="SMOOTH")
        coarse = file == "expressions.glb"
        # Weights of 51 shapes add up in single precision.
        compare(file, truth("coarse") if coarse else finest, lambda number: number - first, 2e-5 if coarse else 2e-6)
for cache in ("PC2", "MDD"):
    if (folder / f"cache.{cache.lower()}").exists():
        empty_scene()
        bpy.ops.wm.obj_import(filepath=str(folder / "cache.obj"))
        mesh = next(item for item in bpy.context.scene.objects if item.type == "MESH")
        modifier = mesh.modifiers.new("cache", "MESH_CACHE")
        modifier.cache_format = cache
        modifier.filepath = str(folder / f"cache.{cache.lower()}")
        modifier.frame_start = first
        compare(f"cache.{cache.lower()}", finest, lambda number: number, 1e-6)
print("\n".join(failures) or "all as it should be")
sys.stdout.flush()
sys.exit(1 if failures else 0)
