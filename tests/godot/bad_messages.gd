# Messages cut off anywhere and with bytes changed: facet_message.gd says what is wrong or reads something sound, and nothing
# else happens; so with the corpora of the fuzzers of the C and C++ decoders, whole, changed and spliced with each other.
# Environment: FACET_GOLDEN, the folder of golden messages; FACET_CORPORA, folders parted by colons.
extends SceneTree

const Message := preload("res://facet_message.gd")
var refused := 0
var read := 0


func _init():
	seed(1)
	var whole := {}
	for name in ["hello", "subject", "albedo", "frame_displacements", "frame_vertices", "frame_signals", "dropped", "goodbye"]:
		var file := File.new()
		file.open("%s/v1_%s.bin" % [OS.get_environment("FACET_GOLDEN"), name], File.READ)
		whole[name] = file.get_buffer(file.get_len())
	# The golden subject is of profile Displacements; the others have less.
	var subjects := {"frame_displacements": Message.new(whole.subject).subject()}
	subjects["frame_vertices"] = subjects.frame_displacements.duplicate()
	subjects.frame_vertices.control_vertex_count = 0
	subjects["frame_signals"] = subjects.frame_vertices.duplicate()
	subjects.frame_signals.vertex_count = 0
	for name in whole:
		var bytes: PoolByteArray = whole[name]
		var subject = subjects.get(name)
		var wrong := try(bytes, subject)
		if wrong != "":
			print("golden message ", name, ": ", wrong)
		# Cut short: what is cut off is missed, but for the padding at the end.
		for k in 80:
			try(bytes.subarray(0, int(bytes.size() * k / 80.0)), subject)
		for k in 250:
			var changed := bytes
			for n in 1 + randi() % 3:
				# Where offsets and lengths are: at the front, more often than in the arrays.
				changed[randi() % (bytes.size() if k % 2 else int(min(bytes.size(), 400)))] = randi() % 256
			try(changed, subject)
	print("refused %d read %d" % [refused, read])
	corpora(subjects.values())
	print("corpora: refused %d read %d" % [refused, read])
	quit()


func corpora(subjects: Array):
	refused = 0
	read = 0
	var messages := []
	for folder in OS.get_environment("FACET_CORPORA").split(":"):
		var files := Directory.new()
		files.open(folder)
		files.list_dir_begin(true)
		var name := files.get_next()
		while name != "":
			var file := File.new()
			file.open("%s/%s" % [folder, name], File.READ)
			messages.append(file.get_buffer(file.get_len()))
			name = files.get_next()
	# What a subject of the corpora is read as stands for the frames, too.
	for bytes in messages:
		var message = Message.new(bytes)
		if message.kind == Message.SUBJECT:
			var subject = message.subject()
			if message.wrong == "":
				subjects.append(subject)
	print("corpora: %d messages %d subjects" % [messages.size(), subjects.size()])
	for bytes in messages:
		for subject in subjects:
			try(bytes, subject)
			for k in 4:
				var other: PoolByteArray = messages[randi() % messages.size()]
				var at: int = 4 + (randi() % int(min(bytes.size(), other.size()) - 8) & ~3)
				var spliced: PoolByteArray = bytes.subarray(0, at - 1)
				spliced.append_array(other.subarray(at, other.size() - 1))
				try(spliced, subject)
				var changed: PoolByteArray = bytes
				changed[randi() % int(min(changed.size(), 400))] = randi() % 256
				try(changed, subject)


func try(bytes: PoolByteArray, subject) -> String:
	var message = Message.new(bytes)
	match message.kind:
		Message.HELLO:
			message.protocol_version()
		Message.SUBJECT:
			message.subject()
		Message.ALBEDO:
			message.albedo()
		Message.FRAME:
			message.frame(subject)
		Message.DROPPED:
			message.dropped_total()
		Message.GOODBYE:
			message.goodbye_reason()
	if message.wrong == "":
		read += 1
	else:
		refused += 1
	return message.wrong
