# A second rig: a puppet's head with blend shapes under ARKit's names, made here so that the project needs no files of others.
# Every part is a grid of points (s, t); what a shape does is said once, in _at.
extends "res://expression_rig.gd"

const SHAPES = ["jawOpen", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight", "mouthPucker", "mouthFunnel",
	"mouthUpperUpLeft", "mouthUpperUpRight", "mouthLowerDownLeft", "mouthLowerDownRight", "eyeBlinkLeft", "eyeBlinkRight",
	"browInnerUp", "browOuterUpLeft", "browOuterUpRight", "browDownLeft", "browDownRight"]
const HEAD = Vector3(0.082, 0.105, 0.085)  # half axes, m
const SKIN = Color(0.16, 0.42, 0.62)
# name, columns, rows, colour, distance from the head's surface in m, side
const PARTS = [
	["head", 48, 32, SKIN, 0.0, 0],
	["eye", 16, 12, Color(0.94, 0.95, 0.97), 0.001, 1], ["eye", 16, 12, Color(0.94, 0.95, 0.97), 0.001, -1],
	["pupil", 12, 8, Color(0.03, 0.03, 0.05), 0.002, 1], ["pupil", 12, 8, Color(0.03, 0.03, 0.05), 0.002, -1],
	["lid", 16, 6, Color(0.10, 0.30, 0.48), 0.003, 1], ["lid", 16, 6, Color(0.10, 0.30, 0.48), 0.003, -1],
	["brow", 12, 3, Color(0.05, 0.10, 0.16), 0.002, 1], ["brow", 12, 3, Color(0.05, 0.10, 0.16), 0.002, -1],
	["lips", 24, 8, Color(0.62, 0.20, 0.26), 0.001, 0], ["mouth", 24, 8, Color(0.10, 0.02, 0.04), 0.002, 0],
]


func _ready() -> void:
	var rest := _arrays("")
	var shapes := []
	for shape in SHAPES:
		var moved := _arrays(shape)
		for k in rest[Mesh.ARRAY_VERTEX].size():
			moved[Mesh.ARRAY_VERTEX][k] -= rest[Mesh.ARRAY_VERTEX][k]
			moved[Mesh.ARRAY_NORMAL][k] = Vector3.ZERO
			moved[Mesh.ARRAY_COLOR][k] = Color(0, 0, 0, 0)
		moved[Mesh.ARRAY_INDEX] = null
		shapes.append(moved)
	var made := ArrayMesh.new()
	made.blend_shape_mode = Mesh.BLEND_SHAPE_MODE_RELATIVE
	for shape in SHAPES:
		made.add_blend_shape(shape)
	made.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, rest, shapes)
	mesh = made  # last: a MeshInstance looks for shapes when it gets its mesh
	var material := SpatialMaterial.new()
	material.vertex_color_use_as_albedo = true
	material.vertex_color_is_srgb = true
	material.roughness = 0.6
	material.params_cull_mode = SpatialMaterial.CULL_DISABLED
	material_override = material


# All parts with one shape fully on ("": none).
func _arrays(shape: String) -> Array:
	var vertices := PoolVector3Array()
	var normals := PoolVector3Array()
	var colours := PoolColorArray()
	var triangles := PoolIntArray()
	for part in PARTS:
		var columns: int = part[1]
		var rows: int = part[2]
		for row in rows + 1:
			for column in columns + 1:
				var at := _at(part[0], part[5], part[4], 2.0 * column / columns - 1.0, 2.0 * row / rows - 1.0, shape)
				vertices.append(at)
				normals.append((at / (HEAD * HEAD)).normalized())
				colours.append(part[3])
				if row < rows and column < columns:
					var first := vertices.size() - 1
					triangles.append_array(PoolIntArray([first, first + columns + 1, first + 1, first + 1, first + columns + 1, first + columns + 2]))
	var out := []
	out.resize(Mesh.ARRAY_MAX)
	out[Mesh.ARRAY_VERTEX] = vertices
	out[Mesh.ARRAY_NORMAL] = normals
	out[Mesh.ARRAY_COLOR] = colours
	out[Mesh.ARRAY_INDEX] = triangles
	return out


# Point (s, t), both -1 to 1, of a part. side: 1 the puppet's left (+x), -1 its right; a shape of the other side does nothing.
static func _at(part: String, side: int, above: float, s: float, t: float, shape: String) -> Vector3:
	if part == "head":
		var turn := PI * s
		var rise := 0.5 * PI * t
		var on := HEAD * Vector3(sin(turn) * cos(rise), sin(rise), cos(turn) * cos(rise))
		if shape == "jawOpen" and on.z > 0.0:
			on.y -= 0.022 * smoothstep(-0.03, -0.09, on.y) * on.z / HEAD.z
		return on
	var own := shape.ends_with("Left") and side >= 0 or shape.ends_with("Right") and side <= 0 or not (shape.ends_with("Left") or shape.ends_with("Right"))
	var name := shape.trim_suffix("Left").trim_suffix("Right") if own else ""
	var plane := Vector2.ZERO
	match part:
		"eye", "pupil":
			plane = Vector2(0.031 * side, 0.018) + (0.019 if part == "eye" else 0.008) * Vector2(s, t * sqrt(1.0 - s * s))
		"lid":
			var closed := 1.05 if name == "eyeBlink" else 0.12
			var edge := sqrt(1.0 - s * s)
			plane = Vector2(0.031 * side, 0.018) + 0.0205 * Vector2(s, edge * (1.0 - (1.0 - t) * closed))
		"brow":
			var inner := 0.5 - 0.5 * s * side
			var rise := 0.013 * inner if name == "browInnerUp" else 0.013 * (1.0 - inner) if name == "browOuterUp" else -0.009 if name == "browDown" else 0.0
			plane = Vector2(0.031 * side + 0.022 * s, 0.046 - 0.006 * s * s + 0.0035 * t + rise)
		_:
			plane = _mouth(part == "lips", s, t, shape)
	return _on_head(plane, above)


static func _mouth(lips: bool, s: float, t: float, shape: String) -> Vector2:
	var half := Vector2(0.036, 0.0065) if lips else Vector2(0.033, 0.0015)
	var round_off := 1.0 - s * s
	var at := Vector2(half.x * s, -0.045 + half.y * t * sqrt(round_off))
	var this_side := s if shape.ends_with("Left") else -s
	var corner := smoothstep(0.1, 1.0, this_side)
	var lower := 0.5 - 0.5 * t
	var middle := smoothstep(-0.3, 0.4, this_side) * round_off
	match shape.trim_suffix("Left").trim_suffix("Right"):
		"jawOpen":
			at.y -= 0.036 * lower * sqrt(round_off)
			at.x *= 0.94
		"mouthSmile":
			at += Vector2(0.008 * sign(s), 0.017) * corner
		"mouthFrown":
			at += Vector2(0.002 * sign(s), -0.014) * corner
		"mouthPucker":
			at.x *= 0.5
			at.y += 0.006 * t * sqrt(round_off)
		"mouthFunnel":
			at.x *= 0.65
			at.y += 0.010 * t * sqrt(round_off)
		"mouthUpperUp":
			at.y += 0.008 * (1.0 - lower) * middle
		"mouthLowerDown":
			at.y -= 0.008 * lower * middle
	return at


static func _on_head(plane: Vector2, above: float) -> Vector3:
	var inside := 1.0 - plane.x * plane.x / (HEAD.x * HEAD.x) - plane.y * plane.y / (HEAD.y * HEAD.y)
	return Vector3(plane.x, plane.y, HEAD.z * sqrt(max(inside, 0.0)) + above)
