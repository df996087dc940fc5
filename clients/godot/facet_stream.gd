# The stream of a running facetd over its WebSocket (docs/web.md), connecting again by itself. A node: add it to a scene, set
# `url` and `profile`, connect the signals. They come in the main thread.
extends Node

const Message := preload("res://facet_message.gd")

signal subject_changed(subject)  # as facet_message.gd's subject() gives it; albedo() and frame() likewise
signal albedo_changed(albedo)
signal frame_arrived(frame)
signal state_changed(words)  # for people: connected, why not

export var url := "ws://127.0.0.1:8420/stream"
export(int, "Signals", "Displacements", "Vertices") var profile := Message.VERTICES
export var want_albedo := true

const LEAST_WAIT_S := 0.25
const MOST_WAIT_S := 3.0

var subject = null
var received := 0  # frames
var dropped := 0  # frames that came while this reader was busy
var _client: WebSocketClient = null
var _subscribed := false
var _goodbye := ""  # why the connection is to end
var _wait_s := LEAST_WAIT_S
var _until_retry_s := 0.0


func _process(delta: float) -> void:
	if _client == null:
		_until_retry_s -= delta
		if _until_retry_s <= 0.0:
			_connect_again()
		return
	_client.poll()
	var status := _client.get_connection_status()
	if _goodbye != "" or status == NetworkedMultiplayerPeer.CONNECTION_DISCONNECTED:
		_lost(_goodbye if _goodbye != "" else "nobody answers at " + url)
	elif status == NetworkedMultiplayerPeer.CONNECTION_CONNECTED and not _subscribed:
		_subscribe(_client.get_peer(1))


func _connect_again() -> void:
	_client = WebSocketClient.new()
	_subscribed = false
	_goodbye = ""
	# In KiB and packets: one message must fit whole (docs/stream-protocol.md, "Limits").
	_client.set_buffers(Message.MOST_BYTES >> 10, 64, 64, 8)
	# While it is polled the client must not be freed: what goes wrong there is kept until after.
	_client.connect("data_received", self, "_on_data")
	_client.connect("server_close_request", self, "_on_close_request")
	if _client.connect_to_url(url, PoolStringArray(["facet"])) != OK:
		_lost("cannot connect to " + url)


func _subscribe(peer: WebSocketPeer) -> void:
	received = 0
	dropped = 0
	peer.set_write_mode(WebSocketPeer.WRITE_MODE_BINARY)
	_subscribed = peer.put_packet(Message.subscribe(profile, want_albedo, "godot")) == OK
	emit_signal("state_changed", "connected")


func _on_data() -> void:
	var peer := _client.get_peer(1)
	while peer.get_available_packet_count() > 0 and _goodbye == "":
		_read(peer.get_packet())


func _on_close_request(_code: int, reason: String) -> void:
	if _goodbye == "":
		_goodbye = "closed: " + reason


func _lost(why: String) -> void:
	_client = null
	subject = null
	_until_retry_s = _wait_s
	_wait_s = min(2.0 * _wait_s, MOST_WAIT_S)
	emit_signal("state_changed", why)


func _read(bytes: PoolByteArray) -> void:
	var message := Message.new(bytes)
	_wait_s = LEAST_WAIT_S
	match message.kind:
		Message.HELLO:
			if message.protocol_version() != Message.PROTOCOL_VERSION:
				message.wrong = "the server speaks version %d, this project %d" % [message.protocol_version(), Message.PROTOCOL_VERSION]
		Message.SUBJECT:
			var read: Dictionary = message.subject()
			if message.wrong == "":
				subject = read
				emit_signal("subject_changed", subject)
		Message.ALBEDO:
			var read: Dictionary = message.albedo()
			if message.wrong == "":
				emit_signal("albedo_changed", read)
		Message.FRAME:
			var read: Dictionary = message.frame(subject)
			if message.wrong == "":
				received += 1
				emit_signal("frame_arrived", read)
		Message.DROPPED:
			dropped = message.dropped_total()
		Message.GOODBYE:
			_goodbye = "goodbye: " + message.goodbye_reason()
	if message.wrong != "":
		_goodbye = "bad message: " + message.wrong
