// What a test reads of the messages that a page got.
import * as flatbuffers from 'flatbuffers';
import { Body } from '../../clients/kiosk/generated/facet/stream/wire/body';
import { Frame } from '../../clients/kiosk/generated/facet/stream/wire/frame';
import { Message } from '../../clients/kiosk/generated/facet/stream/wire/message';
import { Origin } from '../../clients/kiosk/generated/facet/stream/wire/origin';
import { Subject } from '../../clients/kiosk/generated/facet/stream/wire/subject';
import { meshOf } from '../../clients/kiosk/source/meshes';
import { Rebuilder, applyRows, normalsOf } from '../../clients/kiosk/source/rebuild';

export { applyRows, normalsOf };

/** Of the messages, as they came: the last mesh of a frame by each way, with its number; what the last frame says. */
export function read(messages: Uint8Array[]) {
  let rebuilder: Rebuilder | null = null;
  const found: { whole: ReturnType<typeof meshOf>; rebuilt: ReturnType<typeof meshOf>; image: { width: number; height: number } | null; landmarks: { x: number; y: number }[]; camera: { width: number; height: number } | null; takeTime_s: number | null } =
    { whole: null, rebuilt: null, image: null, landmarks: [], camera: null, takeTime_s: null };
  for (const bytes of messages) {
    const message = Message.getRootAsMessage(new flatbuffers.ByteBuffer(new Uint8Array(bytes)));
    if (message.bodyType() === Body.Subject) {
      const hierarchy = (message.body(new Subject()) as Subject).hierarchy();
      rebuilder = hierarchy ? Rebuilder.of(hierarchy) : null;
    } else if (message.bodyType() === Body.Frame) {
      const frame = message.body(new Frame()) as Frame;
      const mesh = meshOf(frame, rebuilder);
      if (mesh) {
        found[mesh.coarse ? 'rebuilt' : 'whole'] = mesh;
      }
      const image = frame.frameSet()?.images(0);
      found.image = image?.pixelsArray() ? { width: image.widthPx(), height: image.heightPx() } : null;
      found.takeTime_s = frame.origin() === Origin.Take ? Number(frame.mediaTimeNs()) / 1e9 : null;
      const camera = frame.camera();
      found.camera = camera ? { width: camera.widthPx(), height: camera.heightPx() } : null;
      found.landmarks = Array.from({ length: frame.landmarksPxLength() }, (_, i) => ({ x: frame.landmarksPx(i)!.xPx(), y: frame.landmarksPx(i)!.yPx() }));
    }
  }
  return found;
}
