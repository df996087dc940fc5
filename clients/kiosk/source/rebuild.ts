// The coarse and the refined mesh out of what profile Displacements sends: docs/stream-protocol.md, "Rebuilding".
import type { Hierarchy } from '../generated/facet/stream/wire/hierarchy';

/** Positions are integers of it, mm: half a metre across, and finer than what the stream promises. */
const kStep_mm = 0.01;

export interface RebuiltMesh {
  /** [vertex][3] head frame, integer * stepMm; normals: 32767 is 1. */
  vertices: Int16Array;
  normals: Int16Array;
  /** The same without displacements. */
  coarse: Int16Array;
  coarseNormals: Int16Array;
  /** [vertex] along the coarse mesh's normals, mm; null where nothing was refined. */
  relief: Float32Array | null;
  stepMm: number;
}

interface Rows {
  offsets: Uint32Array;
  columns: Uint32Array;
  weights: Float32Array;
}

/** Unit normals of a mesh, weighted by the triangles' areas. All [count][3]. */
export function normalsOf(triangles: Uint32Array, positions: Float32Array, normals: Float32Array): void {
  normals.fill(0);
  for (let i = 0; i < triangles.length; i += 3) {
    const [a, b, c] = [3 * triangles[i], 3 * triangles[i + 1], 3 * triangles[i + 2]];
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    normals[a] += x; normals[a + 1] += y; normals[a + 2] += z;
    normals[b] += x; normals[b + 1] += y; normals[b + 2] += z;
    normals[c] += x; normals[c + 1] += y; normals[c + 2] += z;
  }
  for (let i = 0; i < normals.length; i += 3) {
    const long = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    normals[i] /= long; normals[i + 1] /= long; normals[i + 2] /= long;
  }
}

/** A level's positions, each a weighted sum of those of the level before. Positions [][3]. */
export function applyRows({ offsets, columns, weights }: Rows, from: Float32Array): Float32Array {
  const to = new Float32Array(3 * (offsets.length - 1));
  for (let row = 0; row + 1 < offsets.length; ++row) {
    let x = 0, y = 0, z = 0;
    for (let i = offsets[row]; i < offsets[row + 1]; ++i) {
      const at = 3 * columns[i];
      const weight = weights[i];
      x += weight * from[at]; y += weight * from[at + 1]; z += weight * from[at + 2];
    }
    to[3 * row] = x; to[3 * row + 1] = y; to[3 * row + 2] = z;
  }
  return to;
}

const toIntegers = (values: Float32Array, scale: number): Int16Array => {
  const out = new Int16Array(values.length);
  for (let i = 0; i < values.length; ++i) {
    out[i] = Math.max(-32767, Math.min(32767, Math.round(values[i] * scale)));
  }
  return out;
};

export class Rebuilder {
  private constructor(private readonly levels: Rows[], private readonly triangles: Uint32Array, private readonly vertexCount: number,
                      private readonly controlCount: number) {}

  /** null: the hierarchy is not of profile Displacements. */
  static of(hierarchy: Hierarchy): Rebuilder | null {
    const levels: Rows[] = [];
    for (let i = 0; i < hierarchy.levelsLength(); ++i) {
      const rows = hierarchy.levels(i)!.fromCoarser();
      const [offsets, columns, weights] = [rows?.rowOffsetsArray(), rows?.columnsArray(), rows?.weightsArray()];
      if (!offsets || !columns || !weights) {
        return null;
      }
      levels.push({ offsets, columns, weights });
    }
    const finest = hierarchy.levels(hierarchy.levelsLength() - 1);
    const triangles = finest?.trianglesArray();
    return finest && triangles && hierarchy.controlVertexCount() > 0
      ? new Rebuilder(levels, triangles, finest.vertexCount(), hierarchy.controlVertexCount()) : null;
  }

  /** control: [control vertex][3] integer * controlStep_mm. displacements: [vertex], likewise; null: not refined. null: they are
      not of this topology. */
  rebuild(control: Int16Array, controlStep_mm: number, displacements: Int16Array | null, step_mm: number): RebuiltMesh | null {
    if (control.length !== 3 * this.controlCount || (displacements && displacements.length !== this.vertexCount)) {
      return null;
    }
    let positions = Float32Array.from(control, (value) => value * controlStep_mm);
    for (const rows of this.levels) {
      positions = applyRows(rows, positions);
    }
    const directions = new Float32Array(positions.length);
    normalsOf(this.triangles, positions, directions);
    const coarse = toIntegers(positions, 1 / kStep_mm);
    const coarseNormals = toIntegers(directions, 32767);
    if (!displacements) {
      return { vertices: coarse, normals: coarseNormals, coarse, coarseNormals, relief: null, stepMm: kStep_mm };
    }
    const relief = Float32Array.from(displacements, (value) => value * step_mm);
    for (let i = 0; i < positions.length; ++i) {
      positions[i] += relief[Math.floor(i / 3)] * directions[i];
    }
    normalsOf(this.triangles, positions, directions);
    return { vertices: toIntegers(positions, 1 / kStep_mm), normals: toIntegers(directions, 32767), coarse, coarseNormals, relief, stepMm: kStep_mm };
  }
}
