// A frame's mesh for the view, whichever profile it came in.
import type { Frame } from '../generated/facet/stream/wire/frame';
import type { Hierarchy } from '../generated/facet/stream/wire/hierarchy';
import type { Level } from '../generated/facet/stream/wire/level';
import type { FaceMesh } from './face_view';
import type { Rebuilder } from './rebuild';

/** Every level, coarse to fine. */
export function levelsOf(hierarchy: Hierarchy): Level[] {
  return [...Array.from({ length: hierarchy.coarserLevelsLength() }, (_, i) => hierarchy.coarserLevels(i)!),
          ...Array.from({ length: hierarchy.levelsLength() }, (_, i) => hierarchy.levels(i)!)];
}

/** null: the frame has none, or none that is of the topology that is known. */
export function meshOf(frame: Frame, rebuilder: Rebuilder | null): FaceMesh | null {
  const camera_from_head = frame.cameraFromHead();
  if (!camera_from_head || frame.subjectId() === BigInt(0)) {
    return null;
  }
  const pose = new Float32Array(12);
  for (let i = 0; i < 12; ++i) {
    pose[i] = camera_from_head.bb!.readFloat32(camera_from_head.bb_pos + 4 * i);
  }
  const confidence = frame.confidenceArray();
  const positions = frame.vertices();
  const [vertices, normals] = [positions?.valuesArray(), frame.normalsArray()];
  if (positions && vertices && normals) {
    return { vertices, normals, stepMm: positions.stepMm(), confidence, pose, coarse: null, coarseNormals: null, relief: null };
  }
  const [control, displacements] = [frame.controlVertices(), frame.displacements()];
  const integers = control?.valuesArray();
  const rebuilt = control && integers && rebuilder
    ? rebuilder.rebuild(integers, control.stepMm(), displacements?.valuesArray() ?? null, displacements?.stepMm() ?? 0) : null;
  return rebuilt ? { ...rebuilt, confidence, pose } : null;
}
