# One message of the stream, without the socket's header (docs/stream-protocol.md, daemon/stream/facet.fbs), read where it
# lies: each offset and length is checked before it is followed, each index before it is given out. What a function
# returns counts where `wrong` is still empty.
#
# Long arrays never pass through the script number by number: raw bytes go on to textures, and what must become numbers is
# converted by the engine (bytes2var takes an array's bytes as they lie in the message).
extends Reference

enum { BROKEN = 0, HELLO = 1, SUBSCRIBE = 2, DROPPED = 3, GOODBYE = 4, SUBJECT = 5, ALBEDO = 6, FRAME = 7, RING = 8 }
enum { SIGNALS = 0, DISPLACEMENTS = 1, VERTICES = 2 }
const STATES = ["searching", "acquiring", "tracking", "lost"]

const PROTOCOL_VERSION = 1
const MOST_BYTES = 64 << 20
const MOST_VERTICES = 500000
const MOST_LEVELS = 12
const MOST_NAMES = 1024

var kind := BROKEN
var wrong := ""  # what is broken
var _bytes: PoolByteArray
var _size := 0
var _in := StreamPeerBuffer.new()
var _body := 0


func _init(bytes: PoolByteArray) -> void:
	_bytes = bytes
	_size = bytes.size()
	_in.data_array = bytes
	if _size > MOST_BYTES or not _inside(0, 8) or bytes.subarray(4, 7).get_string_from_ascii() != "FCT1":
		_fail("it is no message")
		return
	var message := _u32(0)
	var type := _field(message, 0, 1)
	_body = _subtable(message, 1)
	if type == 0 or _body == 0:
		_fail("it is no message")
	if wrong == "":
		kind = _u8(type)


# ---- what the messages say -------------------------------------------------------------------------------------


func protocol_version() -> int:
	return _scalar(_body, 0, 4)


func dropped_total() -> int:
	return _scalar(_body, 1, 8)


func goodbye_reason() -> String:
	return _text(_body, 0)


# {id, names [string], control_vertex_count, vertex_count, levels [{vertex_count, triangles}], triangles
# [3 triangle_count] of the finest level, counter-clockwise from outside, texture_coordinates PoolVector2Array
# [vertex_count] u right, v up}. Profile Displacements: levels also have row_offsets, columns and weights.
func subject() -> Dictionary:
	var out := {"id": _scalar(_body, 0, 8), "names": [], "control_vertex_count": 0, "vertex_count": 0, "levels": []}
	_require(out.id != 0, "subject: id is 0")
	for at in _tables(_body, 1, MOST_NAMES):
		out.names.append(_text_at(at))
	var hierarchy := _subtable(_body, 4)
	if hierarchy == 0:
		return out
	out.control_vertex_count = _scalar(hierarchy, 1, 4)
	_require(out.control_vertex_count <= MOST_VERTICES, "hierarchy: control vertex count")
	var coarser: int = out.control_vertex_count
	for at in _tables(hierarchy, 2, MOST_LEVELS):
		var level := {"vertex_count": _scalar(at, 0, 4), "triangles": _numbers(at, 1, TYPE_INT_ARRAY)}
		_require(level.vertex_count > 0 and level.vertex_count <= MOST_VERTICES and level.vertex_count >= coarser, "level: vertex count")
		_require(level.triangles.size() > 0 and level.triangles.size() % 3 == 0 and _below(level.triangles, level.vertex_count), "level: triangles")
		if out.control_vertex_count > 0:
			_read_stencils(_subtable(at, 2), coarser, level)
		coarser = level.vertex_count
		out.levels.append(level)
		if wrong != "":
			return out
	_require(not out.levels.empty(), "hierarchy: no levels")
	out.vertex_count = coarser
	out.triangles = out.levels[-1].triangles if wrong == "" else PoolIntArray()
	out.texture_coordinates = _numbers(hierarchy, 3, TYPE_VECTOR2_ARRAY, 2)
	_require(out.texture_coordinates.size() == coarser, "hierarchy: texture coordinates")
	return out


# {subject_id, version, scale: linear value of 65535, vertex_count, linear_rgb: bytes of [vertex_count][3] uint16}
func albedo() -> Dictionary:
	var values := _vector(_body, 3, 2)
	_require(values[1] % 3 == 0 and values[1] <= 3 * MOST_VERTICES, "albedo: number of values")
	return {"subject_id": _scalar(_body, 0, 8), "version": _scalar(_body, 1, 8), "scale": _real(_body, 2),
		"vertex_count": values[1] / 3, "linear_rgb": _raw(values, 2)}


# {sequence, state: 0 to 3, degraded_reason, subject_id: 0 where there is no mesh, camera {fy, height_px}, latency_ms}; with
# a mesh also {camera_from_head: Transform mm, expression and avatar_values PoolRealArray as the subject names them,
# albedo_version} and, by profile, {control_vertices, displacements} or {vertices, normals}: {step_mm, count, bytes of int16}, those that are there.
# subject  that the frame names, as subject() gave it; null: what needs it is left out
func frame(subject) -> Dictionary:
	var out := {"sequence": _scalar(_body, 0, 8), "state": _scalar(_body, 3, 1), "degraded_reason": _text(_body, 5),
		"subject_id": _scalar(_body, 9, 8), "latency_ms": 0.0}
	_require(out.state < STATES.size(), "frame: unknown tracking state")
	var camera := _field(_body, 6, 24)
	if camera != 0:
		out.camera = {"fy": _real_at(camera + 4), "height_px": _u32(camera + 20)}
	var stages := _subtable(_body, 7)
	if stages != 0:
		out.latency_ms = _real(stages, 9)
	if wrong != "" or out.subject_id == 0 or subject == null or subject.id != out.subject_id:
		return out
	var pose := _field(_body, 10, 48)
	_require(pose != 0, "frame: mesh without pose")
	if wrong != "":
		return out
	var rows := []
	for row in 3:
		rows.append([_real_at(pose + 16 * row), _real_at(pose + 16 * row + 4), _real_at(pose + 16 * row + 8), _real_at(pose + 16 * row + 12)])
	out.camera_from_head = Transform(_column(rows, 0), _column(rows, 1), _column(rows, 2), _column(rows, 3))
	_require(abs(out.camera_from_head.basis.determinant() - 1.0) < 0.05, "frame: pose is not a rotation and a translation")
	out.expression = _numbers(_body, 11, TYPE_REAL_ARRAY)
	_require(out.expression.size() == subject.names.size(), "frame: expression")
	# What an avatar is to be moved by: counted from the neutral pose and tuned, where the daemon knows how.
	out.avatar_values = _numbers(_body, 25, TYPE_REAL_ARRAY) if _field(_body, 25, 4) != 0 else out.expression
	_require(out.avatar_values.size() == subject.names.size(), "frame: avatar values")
	out.albedo_version = _scalar(_body, 15, 8)
	if subject.vertex_count > 0 and subject.control_vertex_count > 0:
		out.control_vertices = _fixed_point(16, 3 * subject.control_vertex_count)
		if _field(_body, 17, 4) != 0:
			out.displacements = _fixed_point(17, subject.vertex_count)
	elif subject.vertex_count > 0:
		out.vertices = _fixed_point(18, 3 * subject.vertex_count)
		var normals := _vector(_body, 19, 2)
		_require(normals[1] == 3 * subject.vertex_count, "frame: normals")
		out.normals = {"step_mm": 1.0 / 32767.0, "count": normals[1], "bytes": _raw(normals, 2)}
	return out


# A Subscribe message. client: for people, ASCII, 64 bytes of it at most.
static func subscribe(profile: int, want_albedo: bool, client: String) -> PoolByteArray:
	# Offsets by hand: root, identifier, Message {type, body} with its vtable, Subscribe with its own, the name.
	var name := client.to_ascii()
	if name.size() > 64:
		name = name.subarray(0, 63)
	var out := StreamPeerBuffer.new()
	out.put_u32(16)
	out.put_data("FCT1".to_ascii())
	for entry in [8, 12, 8, 4]:  # at 8: Message's vtable
		out.put_u16(entry)
	out.put_u32(8)  # at 16: Message
	out.put_u32(24)  # body: from 20 to 44
	out.put_u32(SUBSCRIBE)
	for entry in [12, 16, 4, 12, 13, 8, 0, 0]:  # at 28: Subscribe's vtable, and 4 bytes of padding
		out.put_u16(entry)
	out.put_u32(16)  # at 44: Subscribe
	out.put_u32(PROTOCOL_VERSION)
	out.put_u32(8)  # name: from 52 to 60
	out.put_u8(profile)
	out.put_u8(1 if want_albedo else 0)
	out.put_u16(0)
	out.put_u32(name.size())
	out.put_data(name)
	out.put_u32(0)  # the name's end
	return out.data_array


# ---- FlatBuffers, as far as these messages need them --------------------------------------------------------------


func _fail(what: String) -> void:
	if wrong == "":
		wrong = what


func _require(holds: bool, what: String) -> void:
	if not holds:
		_fail(what)


# Whether [at, at + bytes) is inside and nothing is wrong yet.
func _inside(at: int, bytes: int) -> bool:
	if wrong == "" and (at < 0 or bytes < 0 or at > _size or bytes > _size - at):
		_fail("its structure is broken")
	return wrong == ""


func _u8(at: int) -> int:
	return _bytes[at] if _inside(at, 1) else 0


func _u16(at: int) -> int:
	if not _inside(at, 2):
		return 0
	_in.seek(at)
	return _in.get_u16()


func _u32(at: int) -> int:
	if not _inside(at, 4):
		return 0
	_in.seek(at)
	return _in.get_u32()


func _real_at(at: int) -> float:
	if not _inside(at, 4):
		return 0.0
	_in.seek(at)
	var value := _in.get_float()
	_require(not is_nan(value) and not is_inf(value), "a number is not finite")
	return value if wrong == "" else 0.0


# Where field `id` of a table lies; 0: it is not there.
func _field(table: int, id: int, bytes: int) -> int:
	if not _inside(table, 4):
		return 0
	_in.seek(table)
	var vtable := table - _in.get_32()
	var entry := 4 + 2 * id
	if not _inside(vtable, 4) or entry + 2 > _u16(vtable):
		return 0
	var offset := _u16(vtable + entry)
	return table + offset if offset != 0 and _inside(table + offset, bytes) else 0


func _follow(at: int) -> int:
	var offset := _u32(at)
	_require(offset != 0, "its structure is broken")
	return at + offset if _inside(at + offset, 4) else 0


func _subtable(table: int, id: int) -> int:
	var field := _field(table, id, 4)
	return _follow(field) if field != 0 else 0


# 64 bits come as Godot's signed int: good for ids and counts alike.
func _scalar(table: int, id: int, bytes: int) -> int:
	var field := _field(table, id, bytes)
	if field == 0:
		return 0
	_in.seek(field)
	return _in.get_u8() if bytes == 1 else _in.get_u32() if bytes == 4 else _in.get_64()


func _real(table: int, id: int) -> float:
	var field := _field(table, id, 4)
	return _real_at(field) if field != 0 else 0.0


# [where its first element lies, number of elements]
func _vector(table: int, id: int, element_bytes: int) -> Array:
	var field := _field(table, id, 4)
	var at := _follow(field) if field != 0 else 0
	var count := _u32(at) if at != 0 else 0
	return [at + 4, count] if _inside(at + 4, count * element_bytes) else [0, 0]


func _raw(vector: Array, element_bytes: int) -> PoolByteArray:
	return _bytes.subarray(vector[0], vector[0] + vector[1] * element_bytes - 1) if wrong == "" and vector[1] > 0 else PoolByteArray()


# A vector of 4-byte numbers as an array of the engine: what lies in the message, behind the header that bytes2var wants.
# width  numbers that make one element of that array
func _numbers(table: int, id: int, type: int, width := 1):
	var vector := _vector(table, id, 4)
	_require(vector[1] % width == 0, "an array is cut off")
	var header := StreamPeerBuffer.new()
	header.put_u32(type)
	header.put_u32(vector[1] / width if wrong == "" else 0)
	var bytes := header.data_array
	bytes.append_array(_raw(vector, 4))
	return bytes2var(bytes)


func _tables(table: int, id: int, most: int) -> Array:
	var vector := _vector(table, id, 4)
	_require(vector[1] <= most, "a list is too long")
	var out := []
	for k in vector[1] if wrong == "" else 0:
		out.append(_follow(vector[0] + 4 * k))
	return out


func _text_at(at: int) -> String:
	var length := _u32(at)
	_require(length <= 1024, "a text is too long")
	return _bytes.subarray(at + 4, at + 3 + length).get_string_from_utf8() if length > 0 and _inside(at + 4, length) else ""


func _text(table: int, id: int) -> String:
	var field := _field(table, id, 4)
	return _text_at(_follow(field)) if field != 0 else ""


func _fixed_point(id: int, count: int) -> Dictionary:
	var table := _subtable(_body, id)
	var values := _vector(table, 1, 2) if table != 0 else [0, 0]
	var step_mm := _real(table, 0) if table != 0 else 0.0
	_require(values[1] == count and step_mm > 0.0 and step_mm <= 0.0201, "frame: geometry")
	return {"step_mm": step_mm, "count": count, "bytes": _raw(values, 2)}


static func _column(rows: Array, k: int) -> Vector3:
	return Vector3(rows[0][k], rows[1][k], rows[2][k])


static func _below(indices: PoolIntArray, limit: int) -> bool:
	for index in indices:
		if index < 0 or index >= limit:
			return false
	return true


func _read_stencils(table: int, coarser: int, level: Dictionary) -> void:
	_require(table != 0, "a level has no stencils")
	if wrong != "":
		return
	level.row_offsets = _numbers(table, 0, TYPE_INT_ARRAY)
	level.columns = _numbers(table, 1, TYPE_INT_ARRAY)
	level.weights = _numbers(table, 2, TYPE_REAL_ARRAY)
	_require(level.row_offsets.size() == level.vertex_count + 1 and level.weights.size() == level.columns.size()
		and _below(level.columns, coarser), "stencils: columns")
	var before := 0
	for offset in level.row_offsets:
		_require(offset >= before, "stencils: row offsets")
		before = offset
	_require(before == level.columns.size(), "stencils: row offsets")
