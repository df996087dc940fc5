# The live face, head frame (x to the subject's left, y up, z out of the face), in metres. The finest mesh at full rate: with
# profile Vertices the message's bytes go to textures as they are, and the vertex shader makes numbers of them. With profile
# Displacements the script rebuilds vertices and normals on a thread of its own, as fast as it can.
extends MeshInstance

const Rebuild := preload("res://facet_rebuild.gd")
const VERTICES_A_ROW := 512  # the shader's

var vertex_count := 0
var shown := 0  # frames
var rebuild_ms := 0.0
var _subject = null
var _textures := {}
var _thread: Thread = null
var _albedo = null  # the newest, until its subject is there


func _ready() -> void:
	material_override = ShaderMaterial.new()
	material_override.shader = preload("res://face.shader")


func _exit_tree() -> void:
	if _thread != null:
		_thread.wait_to_finish()


# A subject with topology: its triangles over vertices that are nothing but their numbers.
func set_subject(subject: Dictionary) -> void:
	_subject = subject
	vertex_count = subject.vertex_count
	_textures.clear()
	material_override.set_shader_param("has_albedo", false)
	if vertex_count == 0:
		mesh = null
		return
	var numbers := PoolVector3Array()
	numbers.resize(vertex_count)
	for k in vertex_count:
		numbers[k] = Vector3(k, 0, 0)
	var arrays := []
	arrays.resize(Mesh.ARRAY_MAX)
	arrays[Mesh.ARRAY_VERTEX] = numbers
	arrays[Mesh.ARRAY_TEX_UV] = subject.texture_coordinates
	arrays[Mesh.ARRAY_INDEX] = subject.triangles
	mesh = ArrayMesh.new()
	mesh.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, arrays)
	mesh.custom_aabb = AABB(Vector3(-0.5, -0.5, -0.5), Vector3.ONE)  # where heads are, whatever the numbers say
	_show_albedo()


func set_albedo(albedo: Dictionary) -> void:
	_albedo = albedo
	_show_albedo()


func set_frame(frame: Dictionary) -> void:
	if _subject == null or frame.subject_id != _subject.id or vertex_count == 0:
		return
	if frame.has("vertices"):
		_put("positions", frame.vertices.bytes, Image.FORMAT_RG8, 2, 3)
		_put("normals", frame.normals.bytes, Image.FORMAT_RG8, 2, 3)
		material_override.set_shader_param("step_mm", frame.vertices.step_mm)
		material_override.set_shader_param("rebuilt", false)
		shown += 1
	elif frame.has("control_vertices") and _thread == null:
		_thread = Thread.new()
		_thread.start(self, "_rebuild", [frame, _subject])


func _rebuild(work: Array) -> void:
	var began := OS.get_ticks_usec()
	var made := Rebuild.mesh(work[0], work[1], work[1].levels.size())
	call_deferred("_rebuilt", work[1], PoolVector3Array(made.vertices), PoolVector3Array(made.normals), 1e-3 * (OS.get_ticks_usec() - began))


func _rebuilt(subject: Dictionary, vertices_mm: PoolVector3Array, normals: PoolVector3Array, took_ms: float) -> void:
	_thread.wait_to_finish()
	_thread = null
	if _subject == null or subject.id != _subject.id:
		return
	rebuild_ms = took_ms
	# What var2bytes writes behind type and length are the floats.
	_put("positions", _behind_header(var2bytes(vertices_mm)), Image.FORMAT_RGBF, 12, 1)
	_put("normals", _behind_header(var2bytes(normals)), Image.FORMAT_RGBF, 12, 1)
	material_override.set_shader_param("rebuilt", true)
	shown += 1


func _show_albedo() -> void:
	if _albedo == null or _subject == null or _albedo.subject_id != _subject.id or _albedo.vertex_count != vertex_count or vertex_count == 0:
		return
	_put("albedo_texels", _albedo.linear_rgb, Image.FORMAT_RG8, 2, 3)
	material_override.set_shader_param("albedo_scale", _albedo.scale)
	material_override.set_shader_param("has_albedo", true)


# Bytes as rows of a texture, the last row filled up with zeros.
func _put(name: String, bytes: PoolByteArray, format: int, texel_bytes: int, texels_a_vertex: int) -> void:
	var width := VERTICES_A_ROW * texels_a_vertex
	var rows := (vertex_count + VERTICES_A_ROW - 1) / VERTICES_A_ROW
	bytes.resize(rows * width * texel_bytes)
	var image := Image.new()
	image.create_from_data(width, rows, false, format, bytes)
	var key := "%s %d" % [name, format]
	if _textures.has(key):
		_textures[key].set_data(image)
	else:
		_textures[key] = ImageTexture.new()
		_textures[key].create_from_image(image, 0)
	material_override.set_shader_param(name, _textures[key])


static func _behind_header(bytes: PoolByteArray) -> PoolByteArray:
	return bytes.subarray(8, bytes.size() - 1)
