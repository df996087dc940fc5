// The two WebSockets of facetd: /stream (docs/stream-protocol.md) and /control (docs/control-protocol.md). Both connect again
// by themselves.
import * as flatbuffers from 'flatbuffers';
import { Albedo } from '../generated/facet/stream/wire/albedo';
import { Body } from '../generated/facet/stream/wire/body';
import { Dropped } from '../generated/facet/stream/wire/dropped';
import { Frame } from '../generated/facet/stream/wire/frame';
import { Goodbye } from '../generated/facet/stream/wire/goodbye';
import { Hello } from '../generated/facet/stream/wire/hello';
import { Message } from '../generated/facet/stream/wire/message';
import { Profile } from '../generated/facet/stream/wire/profile';
import { Subject } from '../generated/facet/stream/wire/subject';
import { Subscribe } from '../generated/facet/stream/wire/subscribe';

export const kProtocolVersion = 1;
const kLeastWait_ms = 250;
const kMostWait_ms = 3000;
/** A daemon that has not answered for so long is asked no more; what waits for it is bounded. A take may be begun and ended
    slower, on a slow disk. */
const kAnswer_ms = 10_000;
const kSlowAnswer_ms = 60_000;
const kSlowMethods = ['record.start', 'record.stop', 'takes.rename', 'takes.delete', 'takes.restore', 'takes.note', 'takes.trim'];
const kMostWaiting = 64;
/** What the page wants of the stream. */
export interface Wanted {
  /** Displacements: the coarse mesh, too. */
  profile: Profile.Vertices | Profile.Displacements;
  images: boolean;
  /** The daemon sends pictures no larger than they are shown. */
  longestImage_px: number;
}

export const kWrongToken = 4403;
export const kTooManyTokens = 4429;

function address(path: string): string {
  return `${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}${path}`;
}

/** A WebSocket that is opened anew whenever it closes. */
abstract class Connection {
  protected socket: WebSocket | null = null;
  private wait_ms = kLeastWait_ms;
  private timer = 0;

  constructor(private readonly path: string) {}

  open(): void {
    const socket = new WebSocket(address(this.path), this.protocols());
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.onopen = () => this.opened();
    socket.onmessage = (event: MessageEvent) => {
      this.wait_ms = kLeastWait_ms;
      this.received(event.data as ArrayBuffer | string);
    };
    socket.onclose = (event: CloseEvent) => {
      if (this.socket !== socket) {
        return;
      }
      this.socket = null;
      this.closed(event.code);
      this.timer = window.setTimeout(() => this.open(), this.wait_ms);
      this.wait_ms = Math.min(2 * this.wait_ms, kMostWait_ms);
    };
  }

  /** Drops the connection and opens another one at once. */
  reopen(): void {
    const old = this.socket;
    this.socket = null;
    window.clearTimeout(this.timer);
    old?.close();
    this.lost();
    this.open();
  }

  /** What was asked over the connection gets no answer any more. */
  protected lost(): void {}

  protected protocols(): string[] {
    return ['facet'];
  }
  protected abstract opened(): void;
  protected abstract received(data: ArrayBuffer | string): void;
  protected abstract closed(code: number): void;
}

export interface StreamEvents {
  connected(): void;
  closed(reason: string): void;
  subject(subject: Subject): void;
  albedo(albedo: Albedo): void;
  /** bytes: of the message. */
  frame(frame: Frame, bytes: number): void;
  dropped(total: number): void;
}

export class StreamConnection extends Connection {
  private reason = '';
  private wanted: Wanted = { profile: Profile.Vertices, images: false, longestImage_px: 0 };
  /** The server speaks a protocol that this page does not. */
  foreign = false;

  constructor(private readonly events: StreamEvents) {
    super('/stream');
  }

  want(wanted: Wanted): void {
    const { profile, images, longestImage_px } = this.wanted;
    if (profile !== wanted.profile || images !== wanted.images || longestImage_px !== wanted.longestImage_px) {
      this.wanted = wanted;
      this.subscribe();
    }
  }

  private subscribe(): void {
    if (this.socket?.readyState !== WebSocket.OPEN) {
      return;
    }
    const builder = new flatbuffers.Builder(128);
    const client = builder.createString('kiosk');
    Subscribe.startSubscribe(builder);
    Subscribe.addProtocolVersion(builder, kProtocolVersion);
    Subscribe.addProfile(builder, this.wanted.profile);
    Subscribe.addClient(builder, client);
    Subscribe.addWantImages(builder, this.wanted.images);
    Subscribe.addLongestImagePx(builder, this.wanted.longestImage_px);
    const subscribe = Subscribe.endSubscribe(builder);
    Message.finishMessageBuffer(builder, Message.createMessage(builder, Body.Subscribe, subscribe));
    this.socket.send(builder.asUint8Array());
  }

  protected opened(): void {
    this.reason = '';
    this.subscribe();
    this.events.connected();
  }

  protected closed(): void {
    this.events.closed(this.reason);
  }

  protected received(data: ArrayBuffer | string): void {
    if (typeof data === 'string') {
      return;
    }
    const buffer = new flatbuffers.ByteBuffer(new Uint8Array(data));
    this.foreign = !Message.bufferHasIdentifier(buffer);
    if (this.foreign) {
      return;
    }
    const message = Message.getRootAsMessage(buffer);
    switch (message.bodyType()) {
      case Body.Hello:
        this.foreign = (message.body(new Hello()) as Hello).protocolVersion() !== kProtocolVersion;
        break;
      case Body.Goodbye:
        this.reason = (message.body(new Goodbye()) as Goodbye).reason() ?? '';
        break;
      case Body.Subject:
        this.events.subject(message.body(new Subject()) as Subject);
        break;
      case Body.Albedo:
        this.events.albedo(message.body(new Albedo()) as Albedo);
        break;
      case Body.Dropped:
        this.events.dropped(Number((message.body(new Dropped()) as Dropped).total()));
        break;
      case Body.Frame:
        this.events.frame(message.body(new Frame()) as Frame, data.byteLength);
        break;
      default:
        break; // of a later release
    }
  }
}

export class ControlError extends Error {
  constructor(readonly code: number, message: string) {
    super(message);
  }
}

/** The daemon does not answer, as an error's code. */
export const kUnreachable = 0;
export const kPermissionDenied = -32020;

type Waiting = { resolve: (value: unknown) => void; reject: (error: Error) => void; timer: number };

export class ControlConnection extends Connection {
  private next = 1;
  private readonly waiting = new Map<number, Waiting>();

  /** tokenRefused: the token that was shown last does not open; the connection is then opened without it. */
  constructor(public token: string, private readonly tokenRefused: (code: number) => void, private readonly isOpen: () => void) {
    super('/control');
  }

  /** What "name" answers. Throws ControlError. */
  call<Result>(method: string, params: object = {}): Promise<Result> {
    return new Promise<Result>((resolve, reject) => {
      if (this.socket?.readyState !== WebSocket.OPEN) {
        reject(new ControlError(kUnreachable, 'not connected'));
        return;
      }
      if (this.waiting.size >= kMostWaiting) {
        reject(new ControlError(kUnreachable, 'too much waits for an answer'));
        return;
      }
      const id = this.next++;
      const timer = window.setTimeout(() => {
        this.waiting.delete(id);
        reject(new ControlError(kUnreachable, 'no answer'));
      }, kSlowMethods.includes(method) ? kSlowAnswer_ms : kAnswer_ms);
      this.waiting.set(id, { resolve: resolve as (value: unknown) => void, reject, timer });
      this.socket.send(JSON.stringify({ jsonrpc: '2.0', id, method, params }));
    });
  }

  protected override protocols(): string[] {
    return this.token === '' ? ['facet'] : ['facet', `facet.token.${this.token}`];
  }

  protected opened(): void {
    this.isOpen();
  }

  protected received(data: ArrayBuffer | string): void {
    if (typeof data !== 'string') {
      return;
    }
    const answer = JSON.parse(data) as { id: number; result?: unknown; error?: { code: number; message: string } };
    const waiting = this.waiting.get(answer.id);
    this.waiting.delete(answer.id);
    window.clearTimeout(waiting?.timer);
    if (answer.error) {
      waiting?.reject(new ControlError(answer.error.code, answer.error.message));
    } else {
      waiting?.resolve(answer.result);
    }
  }

  protected override lost(): void {
    for (const waiting of this.waiting.values()) {
      window.clearTimeout(waiting.timer);
      waiting.reject(new ControlError(kUnreachable, 'the connection was closed'));
    }
    this.waiting.clear();
  }

  protected closed(code: number): void {
    this.lost();
    if (code === kWrongToken || code === kTooManyTokens) {
      this.token = '';
      this.tokenRefused(code);
    }
  }
}
