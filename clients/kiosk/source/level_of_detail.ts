// Fewer triangles over the same vertices, for machines that draw without a GPU.

/** The triangles whose corners lie in three different cells of a grid, each corner replaced by the first vertex of its cell
 * (vertex clustering [RB93]). What looks up and what looks down is never merged: lips that are closed now will
 * open. vertices, normals: [count][3]; cells: across the longest side. */
export function coarserTriangles(triangles: Uint32Array, vertices: ArrayLike<number>, normals: ArrayLike<number>, cells: number): Uint32Array {
  const least = [Infinity, Infinity, Infinity];
  const most = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < vertices.length; ++i) {
    least[i % 3] = Math.min(least[i % 3], vertices[i]);
    most[i % 3] = Math.max(most[i % 3], vertices[i]);
  }
  const size = Math.max(1e-9, ...most.map((value, axis) => value - least[axis])) / cells;
  const first = new Map<number, number>();
  const stands = new Uint32Array(vertices.length / 3);
  for (let vertex = 0; vertex < stands.length; ++vertex) {
    let cell = normals[3 * vertex + 1] < 0 ? 1 : 0;
    for (let axis = 0; axis < 3; ++axis) {
      cell = cell * (cells + 1) + Math.floor((vertices[3 * vertex + axis] - least[axis]) / size);
    }
    const known = first.get(cell);
    stands[vertex] = known ?? vertex;
    if (known === undefined) {
      first.set(cell, vertex);
    }
  }
  const kept = new Uint32Array(triangles.length);
  let count = 0;
  for (let i = 0; i < triangles.length; i += 3) {
    const [a, b, c] = [stands[triangles[i]], stands[triangles[i + 1]], stands[triangles[i + 2]]];
    if (a !== b && b !== c && c !== a) {
      kept.set([a, b, c], count);
      count += 3;
    }
  }
  return kept.slice(0, count);
}

/** Each edge once, as pairs of vertices. */
export function edgesOf(triangles: Uint32Array): Uint32Array {
  const edges = new Set<number>();
  for (let i = 0; i < triangles.length; i += 3) {
    for (let corner = 0; corner < 3; ++corner) {
      const [a, b] = [triangles[i + corner], triangles[i + ((corner + 1) % 3)]];
      edges.add(Math.min(a, b) * 2 ** 26 + Math.max(a, b));
    }
  }
  const pairs = new Uint32Array(2 * edges.size);
  let count = 0;
  for (const edge of edges) {
    pairs[count++] = Math.floor(edge / 2 ** 26);
    pairs[count++] = edge % 2 ** 26;
  }
  return pairs;
}
