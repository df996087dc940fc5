// Messages of a stream that no daemon sends: half of an egg as a face, in three levels of detail.
import * as flatbuffers from 'flatbuffers';
import { Albedo } from '../../clients/kiosk/generated/facet/stream/wire/albedo';
import { Body } from '../../clients/kiosk/generated/facet/stream/wire/body';
import { Dropped } from '../../clients/kiosk/generated/facet/stream/wire/dropped';
import { FixedPoint } from '../../clients/kiosk/generated/facet/stream/wire/fixed-point';
import { Frame } from '../../clients/kiosk/generated/facet/stream/wire/frame';
import { Hello } from '../../clients/kiosk/generated/facet/stream/wire/hello';
import { Hierarchy } from '../../clients/kiosk/generated/facet/stream/wire/hierarchy';
import { Level } from '../../clients/kiosk/generated/facet/stream/wire/level';
import { Message } from '../../clients/kiosk/generated/facet/stream/wire/message';
import { Pose } from '../../clients/kiosk/generated/facet/stream/wire/pose';
import { Subject } from '../../clients/kiosk/generated/facet/stream/wire/subject';
import { TrackingState } from '../../clients/kiosk/generated/facet/stream/wire/tracking-state';

/** Points along each side of the finest level; a coarser level has each second. */
const kSide = 137;
const kStrides = [4, 2, 1];
export const kTriangles = kStrides.map((stride) => 2 * ((kSide - 1) / stride) ** 2);
const kStep_mm = 0.01;
const kId = BigInt(7);

/** [row * kSide + column] vertex: those of a coarser level come first. */
const numbers = new Map<number, number>();
for (const stride of kStrides) {
  for (let row = 0; row < kSide; row += stride) {
    for (let column = 0; column < kSide; column += stride) {
      const place = row * kSide + column;
      numbers.set(place, numbers.get(place) ?? numbers.size);
    }
  }
}

function trianglesOf(stride: number): number[] {
  const at = (row: number, column: number) => numbers.get(row * kSide + column)!;
  const triangles: number[] = [];
  for (let row = 0; row + stride < kSide; row += stride) {
    for (let column = 0; column + stride < kSide; column += stride) {
      const [a, b] = [at(row, column), at(row, column + stride)];
      const [c, d] = [at(row + stride, column), at(row + stride, column + stride)];
      triangles.push(a, b, d, a, d, c);
    }
  }
  return triangles;
}

function finish(builder: flatbuffers.Builder, type: Body, body: flatbuffers.Offset): Buffer {
  Message.finishMessageBuffer(builder, Message.createMessage(builder, type, body));
  return Buffer.from(builder.asUint8Array());
}

export function hello(): Buffer {
  const builder = new flatbuffers.Builder(256);
  const server = builder.createString('nobody');
  Hello.startHello(builder);
  Hello.addProtocolVersion(builder, 1);
  Hello.addServer(builder, server);
  return finish(builder, Body.Hello, Hello.endHello(builder));
}

/** coarser: with the levels below the finest. */
export function subject(names: string[], coarser: boolean): Buffer {
  const builder = new flatbuffers.Builder(1 << 20);
  const levels = kStrides.map((stride) => {
    const triangles = Level.createTrianglesVector(builder, trianglesOf(stride));
    Level.startLevel(builder);
    Level.addVertexCount(builder, ((kSide - 1) / stride + 1) ** 2);
    Level.addTriangles(builder, triangles);
    return Level.endLevel(builder);
  });
  const finest = Hierarchy.createLevelsVector(builder, levels.slice(-1));
  const others = Hierarchy.createCoarserLevelsVector(builder, coarser ? levels.slice(0, -1) : []);
  Hierarchy.startHierarchy(builder);
  Hierarchy.addId(builder, kId);
  Hierarchy.addLevels(builder, finest);
  Hierarchy.addCoarserLevels(builder, others);
  const hierarchy = Hierarchy.endHierarchy(builder);
  const words = Subject.createExpressionNamesVector(builder, names.map((name) => builder.createString(name)));
  Subject.startSubject(builder);
  Subject.addId(builder, kId);
  Subject.addExpressionNames(builder, words);
  Subject.addHierarchy(builder, hierarchy);
  return finish(builder, Body.Subject, Subject.endSubject(builder));
}

export function albedo(): Buffer {
  const builder = new flatbuffers.Builder(1 << 20);
  const skin = Array.from({ length: 3 * numbers.size }, (_, i) => [60000, 20000, 10000][i % 3]);
  const colours = Albedo.createLinearRgbVector(builder, skin);
  return finish(builder, Body.Albedo, Albedo.createAlbedo(builder, kId, BigInt(1), 1, colours));
}

export function dropped(total: number): Buffer {
  const builder = new flatbuffers.Builder(64);
  Dropped.startDropped(builder);
  Dropped.addTotal(builder, BigInt(total));
  return finish(builder, Body.Dropped, Dropped.endDropped(builder));
}

const places: number[] = new Array(3 * numbers.size);
const normals: number[] = new Array(3 * numbers.size);
const kSize_mm = [75, 100, 90];
for (const [place, vertex] of numbers) {
  const [u, v] = [place % kSide, Math.floor(place / kSide)].map((at) => 2.8 * (at / (kSide - 1) - 0.5));
  const unit = [Math.sin(u) * Math.cos(v), Math.sin(v), Math.cos(u) * Math.cos(v)];
  const long = Math.hypot(...unit.map((value, axis) => value / kSize_mm[axis]));
  unit.forEach((value, axis) => {
    places[3 * vertex + axis] = Math.round((value * kSize_mm[axis]) / kStep_mm);
    normals[3 * vertex + axis] = Math.round((32767 * value) / kSize_mm[axis] / long);
  });
}

const made = new Map<string, Buffer>();

/** confidence: of each vertex; null: there is none. Made once. */
export function frame(expression: number[], confidence: number | null): Buffer {
  const name = JSON.stringify([expression, confidence]);
  made.set(name, made.get(name) ?? newFrame(expression, confidence));
  return made.get(name)!;
}

function newFrame(expression: number[], confidence: number | null): Buffer {
  const builder = new flatbuffers.Builder(1 << 20);
  const values = FixedPoint.createFixedPoint(builder, kStep_mm, FixedPoint.createValuesVector(builder, places));
  const directions = Frame.createNormalsVector(builder, normals);
  const weights = Frame.createExpressionVector(builder, expression);
  const sure = confidence === null ? 0
    : Frame.createConfidenceVector(builder, new Array(numbers.size).fill(Math.round(255 * confidence)));
  Frame.startFrame(builder);
  Frame.addState(builder, TrackingState.Tracking);
  Frame.addSubjectId(builder, kId);
  Frame.addCameraFromHead(builder, Pose.createPose(builder, 1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 500));
  Frame.addExpression(builder, weights);
  Frame.addVertices(builder, values);
  Frame.addNormals(builder, directions);
  if (confidence !== null) {
    Frame.addConfidence(builder, sure);
  }
  return finish(builder, Body.Frame, Frame.endFrame(builder));
}
