# Profile Displacements: the finest mesh rebuilt from control vertices and displacements (docs/stream-protocol.md,
# "Rebuilding"; [MD19 sec. 4.3]), number by number in the script. For links on which bytes count, and for what
# needs the numbers; `profile Vertices` needs none of it.
extends Reference


# Values of fixed point, as facet_message.gd gives it, times their step.
static func scaled(fixed: Dictionary) -> PoolRealArray:
	var input := StreamPeerBuffer.new()
	input.data_array = fixed.bytes
	var out := PoolRealArray()
	out.resize(fixed.count)
	var step: float = fixed.step_mm
	for k in fixed.count:
		out[k] = input.get_16() * step
	return out


# The same as points, mm.
static func points(fixed: Dictionary) -> Array:
	var input := StreamPeerBuffer.new()
	input.data_array = fixed.bytes
	var out := []
	out.resize(fixed.count / 3)
	var step: float = fixed.step_mm
	for k in out.size():
		out[k] = Vector3(input.get_16(), input.get_16(), input.get_16()) * step
	return out


# Level by level, out[row] = sum of weights * coarser[column]; `levels` of them, coarse to fine. mm, head frame.
static func coarse(frame: Dictionary, subject: Dictionary, levels: int) -> Array:
	var vertices := points(frame.control_vertices)
	for l in levels:
		var level: Dictionary = subject.levels[l]
		var offsets: PoolIntArray = level.row_offsets
		var columns: PoolIntArray = level.columns
		var weights: PoolRealArray = level.weights
		var finer := []
		finer.resize(level.vertex_count)
		var entry := 0
		for row in level.vertex_count:
			var sum := Vector3.ZERO
			for k in range(entry, offsets[row + 1]):
				sum += weights[k] * vertices[columns[k]]
			entry = offsets[row + 1]
			finer[row] = sum
		vertices = finer
	return vertices


# Area-weighted unit normals.
static func normals(vertices: Array, triangles: PoolIntArray) -> Array:
	var out := []
	out.resize(vertices.size())
	for v in out.size():
		out[v] = Vector3.ZERO
	for t in range(0, triangles.size(), 3):
		var a := triangles[t]
		var b := triangles[t + 1]
		var c := triangles[t + 2]
		var origin: Vector3 = vertices[a]
		var doubled_area: Vector3 = (vertices[b] - origin).cross(vertices[c] - origin)
		out[a] += doubled_area
		out[b] += doubled_area
		out[c] += doubled_area
	for v in out.size():
		out[v] = out[v].normalized()
	return out


# {vertices: mm, normals}, both [vertex_count of level `levels` - 1]. Displacements belong to the finest level alone.
static func mesh(frame: Dictionary, subject: Dictionary, levels: int) -> Dictionary:
	var triangles: PoolIntArray = subject.levels[levels - 1].triangles
	var vertices := coarse(frame, subject, levels)
	var along := normals(vertices, triangles)
	if levels == subject.levels.size() and frame.has("displacements"):
		var displacements_mm := scaled(frame.displacements)
		for v in vertices.size():
			vertices[v] += displacements_mm[v] * along[v]
		along = normals(vertices, triangles)
	return {"vertices": vertices, "normals": along}
