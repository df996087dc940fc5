# Drives the blend shapes of a mesh by name: put this script on the MeshInstance of any avatar with ARKit's names. A rig
# that spells them otherwise ("EyeBlinkLeft", "eyeBlink_L") is found too.
extends MeshInstance

export var gain := 1.0  # a tracker rarely reaches 1; see docs/bridges.md for what it really drives

var driven := 0  # blend shapes that the last frame set
var _shapes := {}  # plain name: the mesh's own name


# names   [string] as the subject has them
# values  [number of names] 0 to 1
func drive(names: Array, values: PoolRealArray) -> void:
	if _shapes.empty() and mesh is ArrayMesh:
		for k in mesh.get_blend_shape_count():
			_shapes[_plain(mesh.get_blend_shape_name(k))] = mesh.get_blend_shape_name(k)
	driven = 0
	for k in min(names.size(), values.size()):
		var plain := _plain(names[k])
		if _shapes.has(plain):
			set("blend_shapes/" + _shapes[plain], clamp(gain * values[k], 0.0, 1.0))
			driven += 1


# "eyeBlink_L", "EyeBlinkLeft" and "eyeBlinkLeft" are one shape.
static func _plain(name: String) -> String:
	if name.ends_with("_L"):
		name = name.left(name.length() - 2) + "Left"
	elif name.ends_with("_R"):
		name = name.left(name.length() - 2) + "Right"
	return name.to_lower().replace("_", "")
