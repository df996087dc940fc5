# The scene: the live face, and a puppet that the same expression values drive. FACET_URL names another daemon than the one of
# this machine, FACET_PROFILE=displacements another profile.
extends Spatial

const Message := preload("res://facet_message.gd")
# From the camera's axes (x right, y down, z forward) to Godot's (x right, y up, z backward).
const GODOT_FROM_CAMERA := Basis(Vector3(1, 0, 0), Vector3(0, -1, 0), Vector3(0, 0, -1))

onready var stream := $Stream
onready var face := $Face
onready var puppet := $Puppet
var _state := "connecting"
var _frame = null


func _ready() -> void:
	if OS.has_environment("FACET_URL"):
		stream.url = OS.get_environment("FACET_URL")
	if OS.get_environment("FACET_PROFILE") == "displacements":
		stream.profile = Message.DISPLACEMENTS
	stream.connect("subject_changed", face, "set_subject")
	stream.connect("albedo_changed", face, "set_albedo")
	stream.connect("frame_arrived", self, "_on_frame")
	stream.connect("state_changed", self, "_on_state")


func _on_state(words: String) -> void:
	_state = words


func _on_frame(frame: Dictionary) -> void:
	_frame = frame
	if not frame.has("camera_from_head"):
		return
	# The head's turn; its place stays in the picture's middle.
	var turn: Basis = (GODOT_FROM_CAMERA * frame.camera_from_head.basis).orthonormalized()
	face.transform.basis = turn
	puppet.transform.basis = turn
	puppet.drive(stream.subject.names, frame.avatar_values)
	face.set_frame(frame)


func _process(_delta: float) -> void:
	var lines := [_state]
	if _state == "connected" and _frame != null:
		lines = ["%s, frame %d" % [Message.STATES[_frame.state], _frame.sequence],
			"%d vertices, %d shapes, %d pictures/s" % [face.vertex_count, puppet.driven, Engine.get_frames_per_second()]]
		if stream.dropped > 0:
			lines.append("%d frames dropped" % stream.dropped)
		if face.rebuild_ms > 0.0:
			lines.append("rebuilt by the script in %.0f ms" % face.rebuild_ms)
	$Text/Label.text = PoolStringArray(lines).join("\n")
