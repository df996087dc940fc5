# Keeps the meshes of the stream as Godot has them, for check-godot: FOLDER/SEQUENCE.f32, vertices in mm, then normals.
# And the face that is drawn of them.
# Environment: FACET_URL, FACET_PROFILE (displacements, vertices), FACET_FOLDER, FACET_FRAMES (how many).
extends SceneTree

const Message := preload("res://facet_message.gd")
const Stream := preload("res://facet_stream.gd")
const Rebuild := preload("res://facet_rebuild.gd")
var stream = Stream.new()
var face = preload("res://face.gd").new()
var left := int(OS.get_environment("FACET_FRAMES"))


func _init():
	stream.url = OS.get_environment("FACET_URL")
	stream.profile = Message.DISPLACEMENTS if OS.get_environment("FACET_PROFILE") == "displacements" else Message.VERTICES
	stream.connect("state_changed", self, "_on_state")
	stream.connect("albedo_changed", self, "_on_albedo")
	stream.connect("frame_arrived", self, "_on_frame")
	stream.connect("subject_changed", face, "set_subject")
	get_root().call_deferred("add_child", face)
	get_root().call_deferred("add_child", stream)


func _on_state(words: String):
	print("state: ", words)


func _on_albedo(albedo: Dictionary):
	var first = StreamPeerBuffer.new()
	first.data_array = albedo.linear_rgb
	print("albedo: %d %.6f" % [albedo.vertex_count, first.get_u16() * albedo.scale / 65535.0])


func _on_frame(frame: Dictionary):
	if frame.subject_id == 0 or left == 0:
		return
	var made: Dictionary
	if frame.has("vertices"):
		made = {"vertices": Rebuild.points(frame.vertices), "normals": Rebuild.points(frame.normals)}
	else:
		made = Rebuild.mesh(frame, stream.subject, stream.subject.levels.size())
	var file := File.new()
	var path := "%s/%d.f32" % [OS.get_environment("FACET_FOLDER"), frame.sequence]
	file.open(path, File.WRITE)
	for numbers in [made.vertices, made.normals]:
		var bytes := var2bytes(PoolVector3Array(numbers))
		file.store_buffer(bytes.subarray(8, bytes.size() - 1))
	file.close()
	face.set_frame(frame)
	print("face: %d of %d vertices, subject %d" % [face.mesh.surface_get_array_len(0), made.vertices.size(), frame.subject_id])
	print("frame: %d %s %s %.6f" % [frame.sequence, Message.STATES[frame.state], stream.subject.names[0], frame.expression[0]])
	left -= 1
	if left == 0:
		print("done")
		quit()
