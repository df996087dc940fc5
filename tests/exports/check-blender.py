"""Exports as Blender imports them, against the true vertices of every frame.

Usage: blender --background --factory-startup --python check-blender.py -- FOLDER [PICTURE_FOLDER]
FOLDER holds frames.glb, expressions.glb, expressions.fbx, cache.pc2, cache.mdd, cache.obj (of which some may be missing), and the truth:
truth/frame_%06d.f32 and coarse/frame_%06d.f32 (for expressions.*), [vertex_count][3] metres, x right, y up, z towards the viewer;
curves.json, what the expressions' weights are; parts/NAME.i32, which vertices are of which node in expressions.glb.
With PICTURE_FOLDER every import is rendered too. Prints what it compared; exit status 1 where something is off.
"""
import json
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


def vertices(frame, name=None):
    """The one mesh, or the one of a name, as it stands at a frame: world space, turned from Blender's z up to y up."""
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    meshes = [item for item in bpy.context.scene.objects if item.type == "MESH" and name in (None, item.name)]
    assert len(meshes) == 1, f"{len(meshes)} meshes"
    evaluated = meshes[0].evaluated_get(graph)
    mesh = evaluated.to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    matrix = np.array(evaluated.matrix_world)
    evaluated.to_mesh_clear()
    world = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return np.stack([world[:, 0], world[:, 2], -world[:, 1]], axis=1)


def assembled(frame):
    """The vertices of all nodes of expressions.glb in the order of the mesh that they were taken from."""
    parts = {file.stem: np.fromfile(file, np.int32) for file in (folder / "parts").glob("*.i32")}
    points = np.full((sum(len(indices) for indices in parts.values()), 3), np.nan)
    for name, indices in parts.items():
        points[indices] = vertices(frame, name)
    return points


def compare(name, expected, frame_of, tolerance_m, found_at=vertices):
    """tolerance_m: of all vertices, or of each."""
    worst = 0.0
    for number, points in expected.items():
        found = found_at(frame_of(number))
        if found.shape != points.shape:
            failures.append(f"{name}: frame {number} has {len(found)} vertices, not {len(points)}")
            return
        worst = np.maximum(worst, np.abs(found - points).max(axis=1))
    print(f"{name}: {len(expected)} frames of {len(points)} vertices, at most {1e6 * worst.max():.2f} um off")
    right = bool((worst < tolerance_m).all())
    worst = worst.max()
    if not right:
        failures.append(f"{name}: vertices are up to {1e3 * worst:.4f} mm off")
    if pictures:
        render(name, points)


def check_curves(name, first):
    """Names of the shapes, and their values at every frame."""
    curves = json.loads((folder / "curves.json").read_text())
    keys = bpy.context.scene.objects["head"].data.shape_keys.key_blocks
    if [key.name for key in keys][1:] != curves["names"]:
        failures.append(f"{name}: shapes {[key.name for key in keys]}")
        return
    worst = 0.0
    for number, weights in curves["weights"].items():
        bpy.context.scene.frame_set(int(number) - first)
        worst = max(worst, max(abs(key.value - weight) for key, weight in zip(keys[1:], weights)))
    print(f"{name}: {len(curves['names'])} shapes, weights at most {worst:.1e} off")
    if not worst < 1e-5:
        failures.append(f"{name}: weights are up to {worst} off")


def check_skin(name):
    """Every mesh shows a picture as its colour, and nothing is multiplied with it."""
    for item in bpy.context.scene.objects:
        if item.type != "MESH":
            continue
        nodes = item.data.materials[0].node_tree.nodes
        colour = next(node for node in nodes if node.type == "BSDF_PRINCIPLED").inputs["Base Color"]
        source = colour.links[0].from_node if colour.links else None
        if source is None or source.type != "TEX_IMAGE" or tuple(source.image.size) != (256, 256):
            failures.append(f"{name}: {item.name} shows no picture")
            continue
        pixels = np.array(source.image.pixels).reshape(-1, 4)[:, :3]
        if not (pixels.std() > 0.05 and source.image.colorspace_settings.name == "sRGB"):
            failures.append(f"{name}: {item.name} shows no skin")
        if len(item.data.vertex_colors) > 0:
            failures.append(f"{name}: {item.name} has colours besides its picture")


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
if (folder / "frames.glb").exists():
    empty_scene()
    # As docs/exports.md says: Debian 12's Blender 3.4 takes "Use Normal Data" by a name that its NumPy 1.24 has no more.
    bpy.ops.import_scene.gltf(filepath=str(folder / "frames.glb"), import_shading="SMOOTH")
    compare("frames.glb", finest, lambda number: number - first, 2e-6)
coarse = truth("coarse")
if (folder / "expressions.glb").exists():
    empty_scene()
    bpy.ops.import_scene.gltf(filepath=str(folder / "expressions.glb"), import_shading="SMOOTH")
    # Weights of 51 shapes add up in single precision. Eyeballs turn where the take's shrink: a blend of shapes goes straight, and
    # here eyes look to all sides at once.
    tolerances = np.full(len(next(iter(coarse.values()))), 1e-5)
    for eye in ("eyeLeft", "eyeRight"):
        tolerances[np.fromfile(folder / "parts" / f"{eye}.i32", np.int32)] = 3e-3
    compare("expressions.glb", coarse, lambda number: number - first, tolerances, assembled)
    check_curves("expressions.glb", first)
    check_skin("expressions.glb")
    head, *eyes = (bpy.context.scene.objects[name] for name in ("head", "eyeLeft", "eyeRight"))
    if any(eye.parent != head for eye in eyes):
        failures.append("expressions.glb: the eyes do not hang on the head")
    for eye in eyes:
        # The pivot is the eyeball's centre: what lies on the sphere is equally far from it.
        points = np.array([vertex.co for vertex in eye.data.vertices])
        radii = np.linalg.norm(points, axis=1)
        print(f"expressions.glb: {eye.name}, radii {1e3 * radii.min():.2f} to {1e3 * radii.max():.2f} mm")
        if not (np.median(radii) > 0.01 and np.quantile(np.abs(radii / np.median(radii) - 1), 0.9) < 0.1):
            failures.append(f"expressions.glb: {eye.name} does not turn about its centre")
if (folder / "expressions.fbx").exists():
    empty_scene()
    bpy.context.scene.render.fps = 24  # the file tells the rate
    bpy.ops.import_scene.fbx(filepath=str(folder / "expressions.fbx"), anim_offset=0)
    if bpy.context.scene.render.fps / bpy.context.scene.render.fps_base != RATE_HZ:
        failures.append(f"expressions.fbx: {bpy.context.scene.render.fps} frames a second")
    compare("expressions.fbx", coarse, lambda number: number - first, 1e-5)
    check_curves("expressions.fbx", first)
    check_skin("expressions.fbx")
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
