// A take in the live face's place: replay and scrubbing; posing by points on the face; keys on a time-line. The daemon does the
// work (studio.*, pose.* and keys.* of docs/control-protocol.md) and streams the face; this shows it and says what is wanted.
import * as THREE from 'three';
import type { ControlConnection } from './connection';
import type { FaceView } from './face_view';
import { element } from './panels';
import { baseName, type Key, type Keys, type StudioStatus } from './status';
import { number, said, text } from './text';

/** The time-line is this long at least, s. */
const kShortest_s = 5;
/** Between keys, s. */
const kLeastGap_s = 0.05;
const kKeyStep_s = 0.1;
const kPointStep_mm = 1;
const kLook_ms = 200;
/** The daemon lets go of the take so long after the last word of this page, which says one more often. */
const kLease_s = 180;
const kKeep_ms = 10_000;

interface Point {
  vertex: number;
  at: THREE.Vector3; // where it was asked to be, head frame, mm
  colour: string;
  missed: string;
}

export interface StudioHands {
  /** Whoever is at the page has shown the token. */
  mayCommand: () => boolean;
  /** Calls a method, tells where it fails, answers null then. */
  command: <Result>(method: string, params?: object) => Promise<Result | null>;
  tell: (title: string, help?: string) => void;
  /** Asks for a part of a take that becomes a new one, s. */
  trim: (take: string, length_s: number, from_s: number, to_s: number) => void;
}

export class Studio {
  status: StudioStatus | null = null;
  private points: Point[] = [];
  private chosen = -1; // vertex
  private keys: Keys = { keys: [] };
  private key = -1; // chosen, its place among keys
  private head_s = 0;
  private showRegions = true;
  /** Points may go beyond what was captured; else they are pulled back to it. */
  private beyond = false;
  /** The part of the replayed take that is to be kept, s; null: from its beginning, to its end. */
  private kept: { from: number | null; to: number | null } = { from: null, to: null };
  private regionsOf = '';
  private move: { vertex: number; at: THREE.Vector3 } | null = null;
  private moving = false;
  private loadedKeysOf = '';
  private dragging = false;
  private exported = '';
  private lastState = '';

  constructor(private readonly view: FaceView, private readonly control: ControlConnection,
              private readonly hands: StudioHands) {
    view.afterDrawing = () => this.placeHandles();
    this.listen();
    window.setInterval(() => { if (this.isOpen) void this.look(); }, kLook_ms);
    // Where this page goes away nobody asks any more, and the live face comes back.
    window.setInterval(() => { if (this.isOpen && this.hands.mayCommand()) void this.control.call('studio.keep').catch(() => {}); }, kKeep_ms);
  }

  get isOpen(): boolean {
    return this.status !== null && this.status.state !== 'closed';
  }
  private get posing(): boolean {
    return this.status?.posing === true;
  }

  async open(take: string, pose: boolean): Promise<void> {
    if (await this.hands.command('studio.open', { take, pose, lease_s: kLease_s })) {
      await this.look();
    }
  }

  async look(): Promise<void> {
    try {
      this.show(await this.control.call<StudioStatus>('studio.status'));
    } catch { /* the page says that nobody answers */ }
  }

  /** What the daemon says of the studio; null: it is closed. */
  show(status: StudioStatus | null): void {
    const wasOpen = this.isOpen;
    this.status = status;
    if (wasOpen && !this.isOpen) {
      this.points = [];
      this.keys = { keys: [] };
      this.key = this.chosen = -1;
      this.regionsOf = this.loadedKeysOf = this.exported = '';
      this.head_s = 0;
      this.beyond = false;
      this.kept = { from: null, to: null };
      this.view.setRegions(null);
      if (status && status.reason !== '') {
        this.hands.tell(text('studio_changed'), said(status.reason));
      }
    }
    if (status && this.isOpen) {
      if (status.reason !== '' && status.reason !== this.lastState) {
        this.hands.tell(text('studio_failed'), said(status.reason));
      }
      this.lastState = status.reason;
      if (status.exported !== '' && status.exported !== this.exported) {
        this.exported = status.exported;
        this.hands.tell(text('studio_exported', { name: baseName(status.exported) }));
      }
      if (this.posing && this.loadedKeysOf !== status.take) {
        this.loadedKeysOf = status.take;
        void this.loadKeys();
      }
      if (status.shown !== 'pose' && !this.dragging) {
        this.head_s = status.time_s;
      }
      this.takePoints(status);
    }
    this.draw();
  }

  private takePoints(status: StudioStatus): void {
    // While something of ours is on its way, what we asked for is newer.
    if (this.moving || this.move || status.events !== status.solved + status.superseded) {
      return;
    }
    this.points = status.controls.map((control) => {
      const known = this.points.find((point) => point.vertex === control.vertex);
      const at = control.at_mm ? new THREE.Vector3(...control.at_mm) : this.view.vertexAt(control.vertex) ?? new THREE.Vector3();
      return { vertex: control.vertex, at, colour: known?.colour ?? '', missed: control.problem };
    });
    if (!this.points.some((point) => point.vertex === this.chosen)) {
      this.chosen = -1;
    }
    const now = this.points.map((point) => point.vertex).join();
    if (now !== this.regionsOf) {
      this.regionsOf = now;
      void this.loadRegions();
    }
  }

  private async loadRegions(): Promise<void> {
    try {
      const regions = await this.control.call<{ vertices: number[]; colours: [number, number, number][]; rgb: string }>('pose.regions');
      regions.vertices.forEach((vertex, i) => {
        const point = this.points.find((entry) => entry.vertex === vertex);
        if (point) {
          point.colour = `rgb(${regions.colours[i].join()})`;
        }
      });
      const colours = Uint8Array.from(atob(regions.rgb), (letter) => letter.charCodeAt(0));
      this.view.setRegions(this.showRegions && regions.vertices.length > 1 ? colours : null);
    } catch {
      this.view.setRegions(null);
    }
    this.draw();
  }

  private async loadKeys(): Promise<void> {
    const stored = await this.hands.command<{ keys: Keys | null }>('keys.get');
    this.keys = stored?.keys ?? { keys: [] };
    this.key = -1;
    if (this.keys.beyond !== undefined && this.keys.beyond !== this.beyond) {
      this.beyond = this.keys.beyond;
      await this.sendBeyond();
    }
    this.draw();
  }

  /** The pose as it is, by the rule that is chosen now. */
  private async sendBeyond(): Promise<void> {
    const controls = (this.status?.controls ?? []).map(({ vertex, at_mm, at_px }) => (at_mm ? { vertex, at_mm } : { vertex, at_px }));
    await this.hands.command('pose.set', { controls, beyond: this.beyond });
  }

  /** The keys' animation follows the same rule as the pose. */
  private async toggleBeyond(): Promise<void> {
    this.beyond = !this.beyond;
    this.draw();
    await this.sendBeyond();
    if (this.keys.keys.length > 0) {
      this.keys.beyond = this.beyond;
      await this.storeKeys();
    }
    await this.look();
  }

  /** The newest place wins; the next is sent when the last was answered. */
  private async sendMove(): Promise<void> {
    if (this.moving) {
      return;
    }
    this.moving = true;
    while (this.move) {
      const { vertex, at } = this.move;
      this.move = null;
      await this.hands.command('pose.move', { vertex, at_mm: at.toArray() });
    }
    this.moving = false;
  }

  private movePoint(vertex: number, at: THREE.Vector3): void {
    const point = this.points.find((entry) => entry.vertex === vertex);
    if (point) {
      point.at = at;
    } else {
      this.points.push({ vertex, at, colour: '', missed: '' });
    }
    this.move = { vertex, at };
    void this.sendMove();
    this.draw();
  }

  private async removePoint(vertex: number): Promise<void> {
    this.points = this.points.filter((point) => point.vertex !== vertex);
    await this.hands.command('pose.remove', { vertex });
    await this.look();
  }

  // ---- keys ------------------------------------------------------------------------------------------------

  private get length_s(): number {
    return this.posing ? Math.max(kShortest_s, Math.ceil((this.keys.keys.at(-1)?.time_s ?? 0) + 1)) : Math.max(0.001, this.status?.duration_s ?? 0);
  }

  private async saveKey(time_s: number): Promise<void> {
    const answer = await this.hands.command<{ keys: Keys }>('keys.save', { time_s });
    if (answer) {
      this.keys = answer.keys;
      this.key = this.keys.keys.findIndex((entry) => Math.abs(entry.time_s - time_s) < 1e-3);
      this.head_s = time_s;
      this.hands.tell(text('key_saved', { time: number(time_s, 2) }));
    }
    this.draw();
  }

  /** After the last key by a second; where the head stands, if that is later or between keys. */
  private timeOfNext(): number {
    const times = this.keys.keys.map((entry) => entry.time_s);
    if (times.length === 0) {
      return 0;
    }
    const free = times.every((time) => Math.abs(time - this.head_s) > 0.25);
    return free ? Math.round(this.head_s * 100) / 100 : Math.round((times[times.length - 1] + 1) * 100) / 100;
  }

  private async chooseKey(index: number): Promise<void> {
    this.key = index;
    const chosen: Key | undefined = this.keys.keys[index];
    if (chosen) {
      this.head_s = chosen.time_s;
      if (chosen.frame === undefined) {
        await this.hands.command('pose.set', { controls: chosen.controls ?? [], beyond: this.beyond });
      } else {
        await this.hands.command('studio.seek', { what: 'keys', time_s: chosen.time_s });
      }
    }
    await this.look();
  }

  /** Keys keep their order and their distance. */
  private limited(index: number, time_s: number): number {
    const before = this.keys.keys[index - 1]?.time_s;
    const after = this.keys.keys[index + 1]?.time_s;
    const low = before === undefined ? 0 : before + kLeastGap_s;
    const high = after === undefined ? Infinity : after - kLeastGap_s;
    return Math.round(Math.max(low, Math.min(high, time_s)) * 100) / 100;
  }

  private async storeKeys(): Promise<void> {
    if (!(await this.hands.command('keys.set', { keys: this.keys.keys.length > 0 ? this.keys : null }))) {
      await this.loadKeys();
    }
    this.draw();
  }

  private async play(): Promise<void> {
    if (this.status?.state === 'playing') {
      await this.hands.command('studio.pause');
    } else {
      const what = this.posing ? 'keys' : 'take';
      const end_s = what === 'keys' ? this.keys.keys.at(-1)?.time_s ?? 0 : this.status?.duration_s ?? 0;
      await this.hands.command('studio.play', { what, from_s: this.head_s < end_s - 0.05 ? Math.max(0, this.head_s) : 0 });
    }
    await this.look();
  }

  /// An animation is prepared or written: it can be broken off.
  private atWork(): boolean {
    return this.status?.state === 'preparing' || this.status?.state === 'exporting';
  }

  private async cancel(): Promise<void> {
    try {
      await this.control.call('studio.cancel');
    } catch {
      // It was done before.
    }
    await this.look();
  }

  private async export(): Promise<void> {
    const stem = `${this.status?.take ?? 'take'}-animated`;
    for (let count = 1; count < 100; ++count) {
      try {
        await this.control.call('keys.export', { name: count === 1 ? stem : `${stem}-${count}` });
        break;
      } catch (error) {
        if (!(error instanceof Error) || !/exist|there already/.test(error.message)) {
          this.hands.tell(text('studio_failed'), error instanceof Error ? said(error.message) : '');
          break;
        }
      }
    }
    await this.look();
  }

  // ---- what is seen ----------------------------------------------------------------------------------------

  draw(): void {
    const open = this.isOpen;
    const { status } = this;
    element('studio').hidden = !open;
    document.body.toggleAttribute('data-studio', open);
    const mayPose = open && this.posing && this.hands.mayCommand();
    this.view.pressed = mayPose ? (vertex) => this.press(vertex) : null;
    this.drawHandles();
    if (!open || !status) {
      return;
    }
    const ready = this.posing && status.state !== 'opening';
    const percent = number(status.total > 0 ? (100 * status.done) / status.total : 0);
    const end_s = status.shown === 'keys' ? this.keys.keys.at(-1)?.time_s ?? 0 : status.duration_s;
    const words: Record<string, string> = {
      opening: text('studio_opening', { part: percent }), preparing: text('studio_preparing'), exporting: text('studio_exporting', { part: percent }) };
    const standing = status.shown !== 'pose' ? text('studio_playing', { time: number(status.time_s, 1), total: number(end_s, 1) })
      : this.points.length === 0 ? text('studio_pose') : text(this.points.length === 1 ? 'studio_point' : 'studio_points', {
          count: this.points.length, latency: number(status.latency_ms.mean, 1) });
    const missed = this.points.find((point) => point.missed !== '')?.missed;
    this.setText('studio-take', status.take);
    element('studio-take').title = status.take;
    this.setText('studio-state', words[status.state]
      ?? (status.shown === 'pose' && missed ? `${standing} · ${said(missed)}` : standing));
    this.setText('studio-play', text(status.state === 'playing' ? 'pause' : 'play'));
    for (const id of ['key-add', 'key-update', 'key-delete', 'point-remove', 'regions', 'beyond', 'export']) {
      element(id).hidden = !this.posing;
    }
    for (const id of ['trim-start', 'trim-end', 'trim-open']) {
      element(id).hidden = this.posing || status.state === 'opening';
    }
    this.setText('export', text(this.atWork() ? 'cancel' : 'export'));
    const may = this.hands.mayCommand();
    const noKeys = this.keys.keys.length === 0;
    const useless: Record<string, boolean> = {
      'studio-close': false, 'studio-play': this.posing && noKeys, 'key-add': !ready, 'key-update': this.key < 0,
      'key-delete': this.key < 0, 'point-remove': this.chosen < 0, beyond: !ready, export: noKeys, 'trim-start': false, 'trim-end': false,
      'trim-open': false };
    for (const [id, isUseless] of Object.entries(useless)) {
      element<HTMLButtonElement>(id).disabled = isUseless || !may;
      element(id).title = may ? '' : text('needs_token');
    }
    element('regions').setAttribute('aria-pressed', String(this.showRegions));
    element('beyond').setAttribute('aria-pressed', String(this.beyond));
    if (may) {
      element('beyond').title = text('beyond_label');
    }
    this.drawKept();
    element('track').style.setProperty('--seconds', String(Math.max(1, Math.round(this.length_s))));
    element('head').style.left = `${(100 * Math.min(1, this.head_s / this.length_s)).toFixed(2)}%`;
    this.drawKeys();
  }

  /** On the time-line of a replay: what a trim would keep. */
  private drawKept(): void {
    const { from, to } = this.kept;
    const span = element('kept');
    span.hidden = this.posing || (from === null && to === null);
    const part = (time_s: number) => Math.max(0, Math.min(1, time_s / this.length_s));
    span.style.left = `${(100 * part(from ?? 0)).toFixed(2)}%`;
    span.style.right = `${(100 * (1 - part(to ?? this.length_s))).toFixed(2)}%`;
  }

  /** One end of the kept part is where the replay stands; what lies on its other side gives way. */
  private keep(end: 'from' | 'to'): void {
    this.kept[end] = this.head_s;
    const { from, to } = this.kept;
    if (from !== null && to !== null && from >= to) {
      this.kept[end === 'from' ? 'to' : 'from'] = null;
    }
    this.draw();
  }

  private setText(id: string, words: string): void {
    if (element(id).textContent !== words) {
      element(id).textContent = words;
    }
  }

  private drawKeys(): void {
    const place = element('keys');
    place.hidden = !this.posing;
    place.setAttribute('aria-label', text('keys'));
    while (place.children.length > this.keys.keys.length) {
      place.lastElementChild!.remove();
    }
    this.keys.keys.forEach((entry, i) => {
      let button = place.children[i] as HTMLButtonElement | undefined;
      if (!button) {
        button = document.createElement('button');
        button.type = 'button';
        button.dataset.key = String(i);
        place.append(button);
      }
      button.style.left = `${((100 * entry.time_s) / this.length_s).toFixed(2)}%`;
      button.setAttribute('aria-pressed', String(i === this.key));
      button.setAttribute('aria-label', text('key_label', { number: i + 1, time: number(entry.time_s, 2) }));
    });
  }

  private drawHandles(): void {
    const place = element('handles');
    const shown = this.isOpen && this.status?.shown === 'pose' ? this.points : [];
    place.setAttribute('aria-label', text('points'));
    for (const child of [...place.children] as HTMLElement[]) {
      if (!shown.some((point) => String(point.vertex) === child.dataset.vertex)) {
        child.remove();
      }
    }
    this.drawHints();
    shown.forEach((point, i) => {
      let handle = place.querySelector<HTMLButtonElement>(`[data-vertex="${point.vertex}"]`);
      if (!handle) {
        handle = document.createElement('button');
        handle.type = 'button';
        handle.dataset.vertex = String(point.vertex);
        this.listenToHandle(handle, point.vertex);
        place.append(handle);
      }
      handle.className = `handle${point.vertex === this.chosen ? ' chosen' : ''}${point.missed.startsWith('missed') ? ' missed' : ''}`;
      handle.disabled = !this.hands.mayCommand();
      handle.style.setProperty('--colour', point.colour || '#7fd6c8');
      handle.setAttribute('aria-label', text('point_label', { number: i + 1 }));
    });
    this.placeHandles();
  }

  /** Places that people call by name: where a point is likely to be wanted. */
  private drawHints(): void {
    const place = element('hints');
    const open = this.isOpen && this.posing && this.status?.shown === 'pose' && this.hands.mayCommand();
    const wanted = open ? Object.entries(this.status!.places).filter(([, vertex]) => !this.points.some((point) => point.vertex === vertex)) : [];
    place.setAttribute('aria-label', text('hints'));
    const now = wanted.map(([name]) => name).join();
    if (place.dataset.shown === now) {
      return;
    }
    place.dataset.shown = now;
    place.replaceChildren(...wanted.map(([name, vertex]) => {
      const hint = document.createElement('button');
      hint.type = 'button';
      hint.className = 'hint';
      hint.dataset.vertex = String(vertex);
      hint.dataset.place = name;
      hint.setAttribute('aria-label', text('hint_label', { place: name }));
      hint.addEventListener('click', () => this.press(vertex));
      return hint;
    }));
  }

  private placeHandles(): void {
    for (const handle of document.querySelectorAll<HTMLElement>('#handles button, #hints button')) {
      const at = this.view.vertexAt(Number(handle.dataset.vertex));
      if (at) {
        const seen = this.view.onCanvas(at);
        handle.style.left = `${seen.x.toFixed(1)}px`;
        handle.style.top = `${seen.y.toFixed(1)}px`;
      }
    }
  }

  // ---- hands -----------------------------------------------------------------------------------------------

  private press(vertex: number): void {
    const at = this.view.vertexAt(vertex);
    if (at && this.status?.shown === 'pose' && !this.points.some((point) => point.vertex === vertex)) {
      this.chosen = vertex;
      this.movePoint(vertex, at);
    }
  }

  private listenToHandle(handle: HTMLElement, vertex: number): void {
    const stage = element('face');
    let from: THREE.Vector3 | null = null;
    handle.addEventListener('pointerdown', (event) => {
      handle.setPointerCapture(event.pointerId);
      this.chosen = vertex;
      from = this.points.find((point) => point.vertex === vertex)?.at ?? null;
      this.draw();
    });
    handle.addEventListener('pointermove', (event) => {
      if (from) {
        const box = stage.getBoundingClientRect();
        this.movePoint(vertex, this.view.dragged(from, event.clientX - box.left, event.clientY - box.top));
      }
    });
    const end = () => { from = null; };
    handle.addEventListener('pointerup', end);
    handle.addEventListener('pointercancel', end);
    handle.addEventListener('keydown', (event) => {
      const point = this.points.find((entry) => entry.vertex === vertex);
      const steps: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      if (event.key in steps && point) {
        event.preventDefault();
        // A millimetre on the screen.
        const at = this.view.onCanvas(point.at);
        const [dx, dy] = steps[event.key];
        const way = this.view.dragged(point.at, at.x + dx, at.y + dy).sub(point.at);
        this.chosen = vertex;
        this.movePoint(vertex, point.at.clone().addScaledVector(way, kPointStep_mm / Math.max(1e-6, way.length())));
      } else if (event.key === 'Delete' || event.key === 'Backspace') {
        event.preventDefault();
        void this.removePoint(vertex);
      }
    });
  }

  private timeAt(event: PointerEvent): number {
    const box = element('track').getBoundingClientRect();
    return Math.max(0, Math.min(1, (event.clientX - box.left) / box.width)) * this.length_s;
  }

  private listenToTimeline(): void {
    const line = element('timeline');
    let scrubbing = false;
    let held = -1;
    let moved = false;
    let began_px = 0;
    const scrub = (event: PointerEvent) => {
      this.head_s = this.timeAt(event);
      const end_s = this.keys.keys.at(-1)?.time_s ?? 0;
      if (!this.posing || (this.keys.keys.length > 0 && this.head_s <= end_s)) {
        void this.hands.command('studio.seek', { what: this.posing ? 'keys' : 'take', time_s: this.head_s });
      }
      this.draw();
    };
    line.addEventListener('pointerdown', (event) => {
      if (!this.hands.mayCommand()) {
        return;
      }
      const key = (event.target as HTMLElement).dataset.key;
      line.setPointerCapture(event.pointerId);
      moved = false;
      began_px = event.clientX;
      held = key === undefined ? -1 : Number(key);
      scrubbing = held < 0;
      this.dragging = true;
      if (scrubbing) {
        scrub(event);
      }
    });
    line.addEventListener('pointermove', (event) => {
      if (held >= 0 && (moved || Math.abs(event.clientX - began_px) > 4)) {
        moved = true;
        this.keys.keys[held].time_s = this.limited(held, this.timeAt(event));
        this.head_s = held === this.key ? this.keys.keys[held].time_s : this.head_s;
        this.draw();
      } else if (scrubbing) {
        scrub(event);
      }
    });
    const end = () => {
      if (held >= 0 && moved) {
        void this.storeKeys();
      } else if (held >= 0) {
        void this.chooseKey(held);
      }
      held = -1;
      scrubbing = this.dragging = false;
    };
    line.addEventListener('pointerup', end);
    line.addEventListener('pointercancel', end);
    line.addEventListener('keydown', (event) => {
      const key = (event.target as HTMLElement).dataset.key;
      if (key === undefined || !this.hands.mayCommand()) {
        return;
      }
      const step_s = event.key === 'ArrowLeft' ? -kKeyStep_s : event.key === 'ArrowRight' ? kKeyStep_s : 0;
      if (step_s !== 0) {
        event.preventDefault();
        this.keys.keys[Number(key)].time_s = this.limited(Number(key), this.keys.keys[Number(key)].time_s + step_s);
        void this.storeKeys();
      } else if (event.key === 'Enter' || event.key === ' ') {
        event.preventDefault();
        void this.chooseKey(Number(key));
      }
    });
  }

  private listen(): void {
    const click = (id: string, action: () => Promise<void> | void) => element(id).addEventListener('click', () => { void action(); });
    click('studio-close', async () => { await this.hands.command('studio.close'); await this.look(); });
    click('studio-play', () => this.play());
    click('key-add', () => this.saveKey(this.timeOfNext()));
    click('key-update', () => this.saveKey(this.keys.keys[this.key].time_s));
    click('key-delete', async () => {
      this.keys.keys.splice(this.key, 1);
      this.key = -1;
      await this.storeKeys();
    });
    click('point-remove', () => this.removePoint(this.chosen));
    click('regions', async () => {
      this.showRegions = !this.showRegions;
      await this.loadRegions();
    });
    click('beyond', () => this.toggleBeyond());
    click('trim-start', () => this.keep('from'));
    click('trim-end', () => this.keep('to'));
    click('trim-open', () => {
      const { take = '', duration_s = 0 } = this.status ?? {};
      this.hands.trim(take, duration_s, this.kept.from ?? 0, this.kept.to ?? duration_s);
    });
    click('export', () => (this.atWork() ? this.cancel() : this.export()));
    this.listenToTimeline();
    element('takes').addEventListener('click', (event) => {
      const button = (event.target as HTMLElement).closest<HTMLElement>('[data-action]');
      if (button && button.dataset.action !== 'edit') {
        void this.open(button.dataset.take ?? '', button.dataset.action === 'pose');
      }
    });
  }
}
