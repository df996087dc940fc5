# Pictures of the project's own scene, FACET_SHOT-N.png: 0 and 1 some frames apart; then without the stream and with the puppet
# upright, 2 at rest and 3 with open jaw.
extends SceneTree

var scene
var pictures := 0
var due := 3
var idle := 0


func _init():
	scene = load("res://main.tscn").instance()
	get_root().call_deferred("add_child", scene)


func _idle(_delta):
	if scene.face == null:
		return
	if pictures < 2:
		if scene.face.shown >= due and scene.puppet.driven > 0:
			due = scene.face.shown + 4
			keep()
		if pictures == 2:
			print("done: ", scene.get_node("Text/Label").text.replace("\n", "; "))
			scene.stream.set_process(false)
			scene.puppet.transform.basis = Basis()
			pose(0.0)
		return
	idle += 1
	if idle < 4:  # what is set is drawn by then
		return
	idle = 0
	keep()
	if pictures == 4:
		quit()
	pose(1.0)


func keep():
	var picture = get_root().get_texture().get_data()
	picture.flip_y()
	picture.save_png("%s-%d.png" % [OS.get_environment("FACET_SHOT"), pictures])
	pictures += 1


func pose(jaw_open: float):
	var names: Array = scene.puppet.SHAPES
	var values := PoolRealArray()
	for name in names:
		values.append(jaw_open if name == "jawOpen" else 0.0)
	scene.puppet.drive(names, values)
