// The cards beside the face. Each is told what is new and draws itself.
import type { Frame } from '../generated/facet/stream/wire/frame';
import {
  baseName, type BridgeTarget, type CameraPair, type Recording, type Status, type Take, type Takes,
} from './status';
import { bytes, dateTime, duration, number, said, stateText, text, type Key } from './text';

export function element<Type extends HTMLElement>(id: string): Type {
  return document.getElementById(id) as Type;
}

/** A canvas at the screen's own pixels; null while it is not shown. */
function paper(canvas: HTMLCanvasElement): { draw: CanvasRenderingContext2D; width: number; height: number } | null {
  const ratio = Math.min(window.devicePixelRatio, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const draw = canvas.getContext('2d');
  if (!draw || width === 0 || height === 0) {
    return null;
  }
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  draw.setTransform(ratio, 0, 0, ratio, 0, 0);
  draw.clearRect(0, 0, width, height);
  return { draw, width, height };
}

/** One value over the last minute. */
export class Plot {
  private values: { at_ms: number; value: number }[] = [];

  constructor(private readonly name: string, private readonly title: Key, private readonly colour: string, private readonly unit: string) {}

  add(value: number): void {
    const at_ms = performance.now();
    this.values.push({ at_ms, value });
    const first = this.values.findIndex((entry) => entry.at_ms > at_ms - 60_000);
    this.values.splice(0, first);
  }

  show(): void {
    const canvas = element<HTMLCanvasElement>(this.name);
    const now = this.values.at(-1)?.value;
    const all = this.values.map((entry) => entry.value);
    const most = Math.max(...all, 1);
    element(`${this.name}-now`).textContent = now === undefined ? '–' : `${number(now, now < 10 ? 1 : 0)}${this.unit}`;
    canvas.setAttribute('aria-label', text('plot_label', {
      name: text(this.title), now: number(now ?? 0, 1), least: number(all.length ? Math.min(...all) : 0, 1), most: number(all.length ? most : 0, 1) }));
    const on = paper(canvas);
    if (!on) {
      return;
    }
    const { draw, width, height } = on;
    const top = most * 1.15;
    draw.strokeStyle = 'rgba(255,255,255,.07)';
    for (const part of [0.25, 0.5, 0.75]) {
      draw.strokeRect(0, Math.round(height * part) + 0.5, width, 0);
    }
    const end_ms = performance.now();
    const x = (at_ms: number) => width * (1 - (end_ms - at_ms) / 60_000);
    const y = (value: number) => height - 2 - (height - 6) * (value / top);
    if (this.values.length < 2) {
      return;
    }
    draw.beginPath();
    this.values.forEach((entry, i) => (i === 0 ? draw.moveTo(x(entry.at_ms), y(entry.value)) : draw.lineTo(x(entry.at_ms), y(entry.value))));
    draw.strokeStyle = this.colour;
    draw.lineWidth = 2;
    draw.lineJoin = 'round';
    draw.stroke();
    draw.lineTo(x(this.values[this.values.length - 1].at_ms), height);
    draw.lineTo(x(this.values[0].at_ms), height);
    draw.globalAlpha = 0.12;
    draw.fillStyle = this.colour;
    draw.fill();
    draw.globalAlpha = 1;
  }
}

/** The camera's picture, where the stream has one, and the points that were found. */
export function showCamera(frame: Frame): void {
  const canvas = element<HTMLCanvasElement>('camera');
  const set = frame.frameSet();
  const image = set && set.imagesLength() > 0 ? set.images(0) : null;
  const pixels = image?.pixelsArray();
  const camera = frame.camera();
  const source = { width: camera?.widthPx() || image?.widthPx() || 0, height: camera?.heightPx() || image?.heightPx() || 0 };
  if (source.width === 0 || source.height === 0) {
    return;
  }
  const on = paper(canvas);
  if (!on) {
    return;
  }
  const { draw, width, height } = on;
  canvas.setAttribute('aria-label', text(pixels ? 'camera_label' : 'landmarks_label'));
  // The whole picture, in the middle.
  const scale = Math.min(width / source.width, height / source.height);
  const shown = { left: (width - scale * source.width) / 2, top: (height - scale * source.height) / 2 };
  draw.fillStyle = '#0a0d12';
  draw.fillRect(shown.left, shown.top, scale * source.width, scale * source.height);
  if (image && pixels) {
    const ratio = canvas.width / width;
    const copy = draw.createImageData(Math.max(1, Math.floor(scale * source.width * ratio)), Math.max(1, Math.floor(scale * source.height * ratio)));
    const channels = image.channels();
    for (let row = 0; row < copy.height; ++row) {
      const from = Math.floor((row / copy.height) * image.heightPx()) * image.widthPx();
      for (let column = 0; column < copy.width; ++column) {
        const pixel = channels * (from + Math.floor((column / copy.width) * image.widthPx()));
        const to = 4 * (row * copy.width + column);
        for (let c = 0; c < 3; ++c) {
          copy.data[to + c] = pixels[pixel + (channels === 3 ? c : 0)];
        }
        copy.data[to + 3] = 255;
      }
    }
    draw.putImageData(copy, Math.round(shown.left * ratio), Math.round(shown.top * ratio));
  }
  draw.fillStyle = '#7fd6c8';
  for (let i = 0; i < frame.landmarksPxLength(); ++i) {
    const point = frame.landmarksPx(i)!;
    draw.fillRect(shown.left + point.xPx() * scale - 0.8, shown.top + point.yPx() * scale - 0.8, 1.6, 1.6);
  }
}

type Health = 'good' | 'busy' | 'bad' | 'off';
const healths: Record<string, Health> = {
  streaming: 'good', running: 'good', tracking: 'good', recording: 'bad', absent: 'bad', stalled: 'bad', failing: 'bad', failed: 'bad', lost: 'busy',
  searching: 'busy', acquiring: 'busy', opening: 'busy', starting: 'busy', waiting: 'busy', preparing: 'busy' };

function healthRow(name: string, words: string, health: Health, reason = ''): HTMLElement {
  const row = document.createElement('li');
  row.className = health;
  const [dot, label, value] = ['i', 'span', 'b'].map((tag) => document.createElement(tag));
  dot.className = 'dot';
  dot.setAttribute('aria-hidden', 'true');
  label.textContent = name;
  value.textContent = words;
  row.append(dot, label, value);
  if (reason !== '') {
    const why = document.createElement('small');
    why.textContent = reason;
    row.append(why);
  }
  return row;
}

/** Replaces the children of a list only where they differ, so that nobody hears or loses them every second. */
function replace(list: HTMLElement, rows: HTMLElement[]): void {
  const fresh = document.createElement('ul');
  fresh.append(...rows);
  if (fresh.innerHTML !== list.innerHTML) {
    list.replaceChildren(...rows);
  }
}

/** Where in the left camera's picture the calibration holds (green), does not (red), or nothing was seen yet (dark). */
function pairRow(pair: CameraPair): HTMLElement {
  const known = pair.matches > 0;
  const row = healthRow(`${pair.left} / ${pair.right}`, known ? text('pair_error', { error: number(pair.median_px, 2) }) : text('pair_unknown'),
                        pair.problem !== '' ? 'bad' : known ? 'good' : 'busy', pair.problem);
  const seen = pair.error_px.filter((error) => error >= 0).length;
  const map = document.createElement('div');
  map.className = 'coverage';
  map.setAttribute('role', 'img');
  map.setAttribute('aria-label', text('pair_coverage', { camera: pair.left, part: number((100 * seen) / pair.error_px.length) }));
  map.style.setProperty('--columns', String(pair.columns));
  for (const error of pair.error_px) {
    const cell = document.createElement('i');
    if (error >= 0) {
      const kBad_px = 1;
      cell.style.setProperty('--hue', String(Math.round(150 * (1 - Math.min(1, error / kBad_px)))));
      cell.className = 'seen';
    }
    map.append(cell);
  }
  row.append(map);
  return row;
}

/** Whether fine detail is made, and what of it is left out. */
function refinementRow(status: Status): HTMLElement {
  const name = text('device_graphics');
  if (status.gpu === '') {
    return healthRow(name, text('device_graphics_none'), 'off');
  }
  const device = status.gpu.replace(/\s*\(.*\)/, '');
  const left = status.given_up;
  return left === '' ? healthRow(name, device, 'good')
    : healthRow(name, device, 'busy', text('given_up', { left }));
}

function recordingRow(recording: Recording | null, unlocked: boolean): HTMLElement {
  const name = text('device_disk');
  if (!recording) {
    return healthRow(name, text(unlocked ? 'recording_off' : 'recording_locked'), unlocked ? 'good' : 'off');
  }
  const lost = recording.dropped > 0 ? text('recording_lost', { count: number(recording.dropped) }) : '';
  return healthRow(name, stateText(recording.state), healths[recording.state] ?? 'off',
                   [lost, recording.reason].filter(Boolean).join('. '));
}

const kProtocols: Record<string, string> = {
  vmc: 'VMC', live_link_face: 'Live Link Face', ifacialmocap: 'iFacialMocap', vrchat: 'VRChat', vtube_studio: 'VTube Studio',
  vtube_studio_plugin: 'VTube Studio' };

function bridgeRow({ protocol, target, name, frames, failed, reason }: BridgeTarget): HTMLElement {
  const words = text(failed > 0 ? 'bridge_refused' : 'bridge_sent', {
    sent: number(frames), refused: number(failed) });
  return healthRow(`${name || (kProtocols[protocol] ?? protocol)} ${target}`, words,
                   reason !== '' ? 'bad' : frames > 0 ? 'good' : 'busy', said(reason));
}

/** page: skipped, the frames that it was too slow for. */
export function showDevices(status: Status | null, page: { unlocked: boolean; skipped: number }): void {
  if (!status) {
    replace(element('devices'), [healthRow(text('device_service'), text('offline'), 'bad')]);
    return;
  }
  const rows: HTMLElement[] = [];
  const device = (name: string, state: string, reason: string) =>
    rows.push(healthRow(name, stateText(state), healths[state] ?? 'off', reason));
  device(text('device_service'), status.state, status.reason);
  if (status.rig) {
    status.rig.cameras.forEach((camera) => device(camera.name, camera.state, camera.reason));
    rows.push(...(status.rig.pairs ?? []).map(pairRow));
    if (status.rig.trigger) {
      device(text('device_trigger'), status.rig.trigger.state, status.rig.trigger.reason);
    }
  } else if (status.camera) {
    device(text('device_camera'), status.camera.state, status.camera.reason);
  }
  device(text('device_tracking'), status.tracking, '');
  rows.push(refinementRow(status), recordingRow(status.recording, page.unlocked));
  rows.push(...(status.bridges?.targets ?? []).map(bridgeRow));
  rows.push(healthRow(text('device_readers'), number(status.stream.readers.length), 'good'));
  const skipped = text(page.skipped === 0 ? 'page_all' : 'page_skipped', { count: number(page.skipped) });
  rows.push(healthRow(text('device_page'), skipped, 'off'));
  replace(element('devices'), rows);
}

/** Slate and note, as far as a card has room; the whole of it stands in the title. */
function wordsRow(take: Take): HTMLElement | null {
  const kMostShown = 90;
  const slate = take.slate ? text('slate', { scene: take.slate.scene || '–', take: take.slate.take || '–' }) : '';
  const words = [slate, take.note ?? ''].filter(Boolean).join(' · ');
  if (words === '') {
    return null;
  }
  const row = document.createElement('small');
  row.className = 'words';
  row.title = words;
  row.textContent = words.length > kMostShown ? `${words.slice(0, kMostShown).trimEnd()}…` : words;
  return row;
}

function actionButton(take: Take, action: 'replay' | 'pose' | 'edit', unlocked: boolean): HTMLElement {
  const button = document.createElement('button');
  button.type = 'button';
  button.className = 'quiet';
  button.dataset.action = action;
  button.dataset.take = take.name;
  button.textContent = text(action);
  button.disabled = !unlocked;
  button.title = unlocked ? '' : text('needs_token');
  button.setAttribute('aria-label', text(`${action}_label`, { name: take.name }));
  return button;
}

export function showTakes(takes: Takes | null, unlocked: boolean): void {
  if (!takes) {
    return;
  }
  const kMostShown = 30;
  const rows = takes.takes.slice(0, kMostShown).map((take) => {
    const row = document.createElement('li');
    const [name, facts] = ['b', 'small'].map((tag) => document.createElement(tag));
    name.textContent = name.title = take.name;
    row.append(name, facts);
    const actions = document.createElement('div');
    if (take.error !== undefined) {
      facts.textContent = take.error;
      actions.append(actionButton(take, 'edit', unlocked));
      row.append(actions);
      return row;
    }
    facts.textContent = [dateTime(take.created_utc ?? ''), duration(take.duration_s ?? 0),
                         take.closed ? bytes(take.bytes ?? 0) : text('take_open')].join(' · ');
    if (!take.closed) {
      return row;
    }
    if (take.thumbnail !== undefined) {
      const picture = document.createElement('img');
      picture.src = `/thumbnails/${encodeURIComponent(take.name)}?${take.thumbnail}`;
      picture.alt = '';
      row.append(picture);
    }
    const words = wordsRow(take);
    if (words) {
      row.append(words);
    }
    if ((take.mesh_frames ?? 0) > 0) {
      actions.append(actionButton(take, 'replay', unlocked), actionButton(take, 'pose', unlocked));
    }
    actions.append(actionButton(take, 'edit', unlocked));
    const pictures = take.picture_bytes ?? 0;
    const download = (folder: string, file: string, what: 'download' | 'pictures' | 'sound', size: number): void => {
      const link = document.createElement('a');
      link.href = `/${folder}/${encodeURIComponent(take.name)}`;
      link.download = file;
      link.className = 'button quiet';
      link.textContent = text(what);
      link.setAttribute('aria-label', text(`${what}_label`, { name: take.name, size: bytes(size) }));
      actions.append(link);
    };
    download('takes', `${take.name}.take`, 'download', (take.bytes ?? 0) - pictures);
    if (pictures > 0) {
      download('frames', `${take.name}.frames.tar`, 'pictures', pictures);
    }
    if ((take.sound_bytes ?? 0) > 0) {
      download('sounds', `${take.name}.flac`, 'sound', take.sound_bytes ?? 0);
    }
    row.append(actions);
    return row;
  });
  if (rows.length === 0 || takes.count > rows.length) {
    const note = document.createElement('li');
    note.className = 'note';
    note.textContent = rows.length === 0 ? text('takes_none') : text('takes_more', { count: takes.count - rows.length, folder: baseName(takes.folder) });
    rows.push(note);
  }
  replace(element('takes'), rows);
}
