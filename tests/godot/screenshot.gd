# Two pictures of the project's own scene, some frames apart: FACET_SHOT-0.png, FACET_SHOT-1.png.
extends SceneTree

var scene
var pictures := 0
var due := 3


func _init():
	scene = load("res://main.tscn").instance()
	get_root().call_deferred("add_child", scene)


func _idle(_delta):
	if scene.face == null or scene.face.shown < due or pictures == 2 or scene.puppet.driven == 0:
		return
	due = scene.face.shown + 4
	var picture = get_root().get_texture().get_data()
	picture.flip_y()
	picture.save_png("%s-%d.png" % [OS.get_environment("FACET_SHOT"), pictures])
	pictures += 1
	if pictures == 2:
		print("done: ", scene.get_node("Text/Label").text.replace("\n", "; "))
		quit()
