// The camera's picture behind the face, and the slider from the picture by way of the coarse mesh to the refined one.
import type { Frame } from '../generated/facet/stream/wire/frame';
import { Origin } from '../generated/facet/stream/wire/origin';
import type { FaceView, Lens } from './face_view';
import { element } from './panels';
import { text, type Key } from './text';

/** The slider's stops. At the last the face stands free, as without a picture. */
const kStops: { at: number; name: Key }[] = [{ at: 0, name: 'blend_photo' }, { at: 0.5, name: 'blend_coarse' }, { at: 1, name: 'blend_refined' }];
/** So near to a stop a slider that is dragged takes it. */
const kSnap = 0.04;

export class Blend {
  private value = 1;
  private available = false;
  private mirrored = false;
  private lens: Lens | null = null;
  private readonly picture = document.createElement('canvas');
  private hasPicture = false;

  /** changed: what the stream has to bring may be another. */
  constructor(private readonly view: FaceView, private readonly changed: () => void) {
    const slider = element<HTMLInputElement>('blend-slider');
    // A key's steps are smaller than what a finger is helped by.
    let held = false;
    slider.addEventListener('pointerdown', () => { held = true; });
    slider.addEventListener('pointerup', () => { held = false; });
    slider.addEventListener('pointercancel', () => { held = false; });
    slider.addEventListener('input', () => {
      const stop = held ? kStops.find(({ at }) => Math.abs(at - slider.valueAsNumber) < kSnap) : undefined;
      this.set(stop ? stop.at : slider.valueAsNumber);
    });
    kStops.forEach(({ at, name }) => {
      const button = document.createElement('button');
      button.type = 'button';
      button.dataset.text = name;
      button.dataset.at = String(at);
      button.addEventListener('click', () => this.set(at));
      element('blend-stops').append(button);
    });
    view.beforeDrawing = (place) => this.draw(place);
    this.show();
  }

  /** The face stands where the camera sees it, over the camera's picture. */
  get isOver(): boolean {
    return this.available && this.value < 1;
  }

  private set(value: number): void {
    this.value = value;
    element<HTMLInputElement>('blend-slider').value = String(value);
    this.show();
    this.changed();
  }

  /** A frame of the stream. mirrored: as people see themselves. */
  take(frame: Frame, mirrored: boolean): void {
    const set = frame.frameSet();
    const camera = frame.camera();
    const image = set && set.imagesLength() === 1 ? set.images(0) : null;
    // What somebody shows in the live face's place is not what the camera sees.
    const there = frame.origin() === Origin.Live && image !== null && camera !== null && camera.widthPx() > 0 && camera.fx() > 0;
    this.mirrored = mirrored;
    if (there) {
      this.lens = { fx: camera.fx(), fy: camera.fy(), cx: camera.cx(), cy: camera.cy(), width: camera.widthPx(), height: camera.heightPx(), mirrored };
      const pixels = image.pixelsArray();
      if (pixels && this.isOver) {
        this.keep(pixels, image.widthPx(), image.heightPx(), image.channels());
      }
    }
    if (there !== this.available) {
      this.available = there;
      this.hasPicture = false;
      this.changed();
    }
    this.show();
  }

  private keep(pixels: Uint8Array, width: number, height: number, channels: number): void {
    if (this.picture.width !== width || this.picture.height !== height) {
      [this.picture.width, this.picture.height] = [width, height];
    }
    const draw = this.picture.getContext('2d')!;
    const copy = draw.createImageData(width, height);
    for (let from = 0, to = 0; to < copy.data.length; from += channels, to += 4) {
      copy.data[to] = pixels[from];
      copy.data[to + 1] = pixels[from + (channels === 3 ? 1 : 0)];
      copy.data[to + 2] = pixels[from + (channels === 3 ? 2 : 0)];
      copy.data[to + 3] = 255;
    }
    draw.putImageData(copy, 0, 0);
    this.hasPicture = true;
  }

  /** place: where the picture lies on the stage, CSS pixels; null: nowhere. */
  private draw(place: { left: number; top: number; scale: number } | null): void {
    const canvas = element<HTMLCanvasElement>('photo');
    canvas.hidden = !place || !this.hasPicture || !this.lens;
    if (canvas.hidden || !place || !this.lens) {
      return;
    }
    const ratio = Math.min(window.devicePixelRatio, 2);
    const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) {
      [canvas.width, canvas.height] = [width, height];
    }
    const draw = canvas.getContext('2d')!;
    draw.setTransform(1, 0, 0, 1, 0, 0);
    draw.clearRect(0, 0, width, height);
    const size = { width: this.lens.width * place.scale, height: this.lens.height * place.scale };
    draw.setTransform((this.mirrored ? -1 : 1) * ratio, 0, 0, ratio, (this.mirrored ? place.left + size.width : place.left) * ratio, place.top * ratio);
    draw.drawImage(this.picture, 0, 0, size.width, size.height);
  }

  /** The control, and what the view makes of it. */
  show(): void {
    element('blend').hidden = !this.available;
    document.body.toggleAttribute('data-mirrored', this.isOver && this.mirrored);
    element('blend-slider').setAttribute('aria-label', text('blend_label'));
    element('blend-slider').setAttribute('aria-valuetext', this.words());
    for (const button of element('blend-stops').children as HTMLCollectionOf<HTMLElement>) {
      button.setAttribute('aria-pressed', String(Number(button.dataset.at) === this.value));
    }
    this.view.setOver(this.isOver ? this.lens : null, Math.min(1, 2 * this.value), Math.max(0, 2 * this.value - 1));
  }

  private words(): string {
    const stop = kStops.find(({ at }) => at === this.value);
    return stop ? text(stop.name) : text('blend_between', {
      from: text(this.value < 0.5 ? 'blend_photo' : 'blend_coarse'), to: text(this.value < 0.5 ? 'blend_coarse' : 'blend_refined') });
  }
}
