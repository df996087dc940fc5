"""Run inside Blender by bench/cycles: renders what `facet synth --surfaces` wrote in Cycles.

Arguments after "--": the folder that synth made, the folder for video.mkv, samples a pixel.

Blender's world is the camera's frame with y up and z towards the camera, in metres: a default camera at the origin sees it. What is not the actor, and the
sensor's blur and noise, are made as Facet makes them, so that only the rendering differs.
"""
import json
import math
import subprocess
import sys
import time
from pathlib import Path

import bpy
import numpy as np

UPRIGHT = np.array([1, -1, -1], np.float32)  # x right, y down, z forward to Blender's axes
FULL_WELL_E, READ_NOISE_E, SIDE = 6000, 5, 0.1  # daemon/simulation/sensor


def read_surfaces(file):
    """Positions (m, Blender's axes), albedo and triangles of a PLY as write_truth_ply writes it."""
    data = file.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:end].decode()
    count = {line.split()[1]: int(line.split()[2]) for line in header.splitlines() if line.startswith("element")}
    vertex = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("albedo", "<f4", 3), ("srgb", "u1", 3)])
    face = np.dtype([("corners", "u1"), ("vertex", "<i4", 3)])
    vertices = np.frombuffer(data, vertex, count["vertex"], end)
    faces = np.frombuffer(data, face, count["face"], end + vertices.nbytes)
    return 1e-3 * vertices["position"] * UPRIGHT, vertices["albedo"], faces["vertex"]


def nodes_of(owner):
    owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree.nodes, owner.node_tree.links


def skin_material():
    material = bpy.data.materials.new("albedo")
    nodes, links = nodes_of(material)
    colour = nodes.new("ShaderNodeAttribute")
    colour.attribute_name = "albedo"
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Roughness"].default_value = 0
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(colour.outputs["Color"], diffuse.inputs["Color"])
    links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    return material


def emission(owner, kind, colour, strength):
    nodes, links = nodes_of(owner)
    light = nodes.new(kind)
    light.inputs["Color"].default_value = (*colour, 1)
    light.inputs["Strength"].default_value = strength
    output = nodes.new("ShaderNodeOutputMaterial" if kind == "ShaderNodeEmission" else "ShaderNodeOutputWorld")
    links.new(light.outputs[0], output.inputs["Surface"])
    return nodes, links, light


def add_lamp(lamp, index):
    """A rectangle whose radiance gives a white surface at the reference distance, facing it, the value of `irradiance`: E / pi = irradiance, and
    E = L area / d^2."""
    centre, u, v = (1e-3 * np.array(lamp[key]) * UPRIGHT for key in ("centre_mm", "half_u_mm", "half_v_mm"))
    mesh = bpy.data.meshes.new(f"lamp {index}")
    mesh.from_pydata([tuple(centre + a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))], [], [(0, 1, 2, 3)])
    area = 4 * np.linalg.norm(u) * np.linalg.norm(v)
    radiance = np.array(lamp["irradiance"]) * math.pi * (1e-3 * lamp["reference_distance_mm"]) ** 2 / area
    material = bpy.data.materials.new(f"lamp {index}")
    emission(material, "ShaderNodeEmission", radiance / radiance.max(), radiance.max())
    mesh.materials.append(material)
    thing = bpy.data.objects.new(f"lamp {index}", mesh)
    thing.visible_camera = False
    bpy.context.collection.objects.link(thing)


def set_surroundings(harmonics):
    """Radiance whose irradiance over pi is the polynomial of nine coefficients in the normal: the cosine takes 1, 2/3 and 1/4 of the three bands [RH01].
    Order: 1; x y z; xy xz yz x^2-y^2 3z^2-1."""
    l = [value / part for value, part in zip(harmonics, (1, *3 * (2 / 3,), *5 * (1 / 4,)))]
    square = np.array([[l[7] - l[8], l[4] / 2, l[5] / 2], [l[4] / 2, -l[7] - l[8], l[6] / 2], [l[5] / 2, l[6] / 2, 2 * l[8]]])  # 3z^2-1 = 2z^2-x^2-y^2
    world = bpy.data.worlds.new("surroundings")
    bpy.context.scene.world = world
    nodes, links, light = emission(world, "ShaderNodeBackground", (1, 1, 1), 1)
    towards = nodes.new("ShaderNodeTexCoord").outputs["Generated"]

    def dot(a, b):
        node = nodes.new("ShaderNodeVectorMath")
        node.operation = "DOT_PRODUCT"
        for socket, value in zip(node.inputs, (a, b)):
            if hasattr(value, "is_output"):
                links.new(value, socket)
            else:
                socket.default_value = tuple(value)
        return node.outputs["Value"]

    def add(a, b):
        node = nodes.new("ShaderNodeMath")
        node.operation = "ADD"
        links.new(a, node.inputs[0])
        if hasattr(b, "is_output"):
            links.new(b, node.inputs[1])
        else:
            node.inputs[1].default_value = b
        return node.outputs["Value"]

    rows = nodes.new("ShaderNodeCombineXYZ")
    for axis in range(3):
        links.new(dot(towards, square[axis]), rows.inputs[axis])
    links.new(add(add(dot(towards, rows.outputs["Vector"]), dot(towards, l[1:4])), l[0]), light.inputs["Strength"])


def set_camera(camera):
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit = "HORIZONTAL"
    lens.sensor_width = 36
    lens.lens = camera["fx"] * 36 / camera["width"]
    lens.shift_x = -(camera["cx"] - (camera["width"] - 1) / 2) / camera["width"]
    lens.shift_y = (camera["cy"] - (camera["height"] - 1) / 2) / camera["width"]
    thing = bpy.data.objects.new("camera", lens)
    bpy.context.collection.objects.link(thing)
    bpy.context.scene.camera = thing


def set_renderer(camera, samples):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.max_bounces = 1
    scene.cycles.diffuse_bounces = 1
    scene.cycles.sample_clamp_indirect = 0
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 1
    scene.render.threads_mode = "FIXED"
    scene.render.threads = 2
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = camera["width"], camera["height"]
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.image_settings.color_depth = "32"


def rendered(file):
    """Linear RGB times alpha, and alpha, top row first."""
    bpy.context.scene.render.filepath = str(file)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(4 * width * height, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    pixels = pixels.reshape(height, width, 4)[::-1]
    return pixels[..., :3], pixels[..., 3:]


def to_linear(srgb):
    value = srgb.astype(np.float32) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def to_srgb(linear):
    value = np.clip(linear, 0, 1)
    return np.rint(255 * np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)).astype(np.uint8)


def blurred(light):
    for axis in (0, 1):
        around = np.pad(light, [(1, 1) if k == axis else (0, 0) for k in range(3)], mode="edge")
        count = light.shape[axis]
        light = (1 - 2 * SIDE) * light + SIDE * (np.take(around, range(count), axis) + np.take(around, range(2, count + 2), axis))
    return light


def main():
    own, folder, samples = sys.argv[sys.argv.index("--") + 1:]
    own, folder = Path(own), Path(folder)
    camera = json.loads((own / "camera.json").read_text())
    width, height = camera["width"], camera["height"]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    set_camera(camera)
    set_renderer(camera, int(samples))
    set_surroundings(camera["light"]["spherical_harmonics"])
    for index, lamp in enumerate(camera["light"]["area_lights"]):
        add_lamp(lamp, index)
    decoded = subprocess.run(["ffmpeg", "-v", "error", "-i", own / "video.mkv", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"], stdout=subprocess.PIPE, check=True).stdout
    ours = np.frombuffer(decoded, np.uint8).reshape(-1, height, width, 3)
    video = subprocess.Popen(["ffmpeg", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(camera["fps"]), "-i", "-",
                              "-c:v", "ffv1", "-pix_fmt", "bgr0", "-f", "matroska", "-y", folder / "video.mkv.part"], stdin=subprocess.PIPE)
    mesh, material, ratios, apart = None, skin_material(), [], []
    began = time.monotonic()
    for index, picture in enumerate(ours):
        positions, albedo, triangles = read_surfaces(own / "surfaces" / f"frame_{index:06}.ply")
        if mesh is None:
            mesh = bpy.data.meshes.new("actor")
            mesh.from_pydata(positions, [], triangles)
            mesh.polygons.foreach_set("use_smooth", np.ones(len(triangles), bool))
            mesh.attributes.new("albedo", "FLOAT_COLOR", "POINT")
            mesh.materials.append(material)
            bpy.context.collection.objects.link(bpy.data.objects.new("actor", mesh))
        mesh.vertices.foreach_set("co", positions.ravel())
        mesh.attributes["albedo"].data.foreach_set("color", np.c_[albedo, np.ones(len(albedo), np.float32)].ravel())
        mesh.update()
        light, alpha = rendered(folder / "frame.exr")
        linear = to_linear(picture)
        developed = blurred(light)
        noise = np.random.default_rng(index).standard_normal(light.shape) * np.sqrt(np.maximum(developed, 0) * FULL_WELL_E + READ_NOISE_E**2) / FULL_WELL_E
        made = to_srgb(developed + alpha * noise + (1 - alpha) * linear)
        video.stdin.write(made.tobytes())
        inside = blurred(alpha)[..., 0] > 0.999
        theirs = to_linear(made)
        ratios.append(theirs[inside].mean() / linear[inside].mean())
        apart.append(np.sqrt(np.mean((theirs[inside] - linear[inside]) ** 2)))
        if index in (0, len(ours) // 2):
            rows = np.concatenate([picture, made], axis=1)
            subprocess.run(["ffmpeg", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{2 * width}x{height}", "-i", "-", "-y", folder / f"both-{index}.png"],
                           input=rows.tobytes(), check=True)
        spent = time.monotonic() - began
        print(f"Cycles {index + 1}/{len(ours)} frames, {spent / (index + 1) * (len(ours) - index - 1) / 60:.0f} min left", file=sys.stderr, flush=True)
    video.stdin.close()
    if video.wait() != 0:
        raise SystemExit("ffmpeg could not write the video")
    (folder / "frame.exr").unlink()
    (folder / "pictures.txt").write_text(f"pictures, where the actor is: Cycles {np.mean(ratios):.4f} times as bright as Facet, rms of the difference "
                                         f"{np.mean(apart):.4f} linear (noise of both sensors included)\n")
    (folder / "video.mkv.part").rename(folder / "video.mkv")


main()
