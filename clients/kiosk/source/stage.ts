// Around the face: what covers it, what its colours mean, where there is more than is seen.
import type { FaceView, View } from './face_view';
import { element } from './panels';
import { text, type Key } from './text';

/** Keeps the face between the notes above and the controls below, whatever their heights are. A note that
    comes for some seconds moves nothing. */
export function keepFree(view: FaceView): void {
  const [notes, controls] = [element('notes'), element('controls')];
  let top = parseFloat(getComputedStyle(notes).minHeight);
  const fit = () => {
    if (element('banner').hidden) {
      top = notes.offsetHeight;
    }
    view.setCovered(top, controls.offsetHeight);
  };
  const views = element('views');
  new ResizeObserver(() => showChosen(views)).observe(views);
  const watch = new ResizeObserver(fit);
  [notes, controls, element('stage')].forEach((part) => watch.observe(part));
}

/** Scrolls a row of buttons to the one that is pressed. */
export function showChosen(row: HTMLElement): void {
  row.querySelector('[aria-pressed=true]')?.scrollIntoView({ block: 'nearest', inline: 'center' });
}

interface Legend {
  /** What is grey; none: nothing is. */
  grey: Key | null;
  /** A ball in the view's colours instead of a ramp. */
  ball?: true;
  /** What the ramp begins and ends with. */
  from: Key;
  to: Key;
  ramp: string;
}
const kLegends: Partial<Record<View, Legend>> = {
  normals: { grey: null, ball: true, from: 'legend_normals', to: 'legend_axes', ramp: '' },
  relief: { grey: 'legend_even', from: 'legend_in', to: 'legend_out', ramp: '#4d80df, #b9b9b9, #df7a3e' },
  confidence: {
    grey: 'legend_nothing', from: 'legend_unsure', to: 'legend_sure', ramp: '#dd6650, #e0b062, #5fbfb0' },
};

/** A ball as the view of normals has it: x to the right, y up, z towards the camera. */
function ball(): HTMLCanvasElement {
  const canvas = document.createElement('canvas');
  const size = (canvas.width = canvas.height = 68);
  const draw = canvas.getContext('2d')!;
  const picture = draw.createImageData(size, size);
  for (let row = 0; row < size; ++row) {
    for (let column = 0; column < size; ++column) {
      const [x, y] = [(2 * column + 1) / size - 1, 1 - (2 * row + 1) / size];
      const z = Math.sqrt(Math.max(0, 1 - x * x - y * y));
      const inside = x * x + y * y < 1;
      picture.data.set([x, y, z].map((part) => 255 * (0.5 + 0.5 * part)), 4 * (row * size + column));
      picture.data[4 * (row * size + column) + 3] = inside ? 255 : 0;
    }
  }
  draw.putImageData(picture, 0, 0);
  return canvas;
}

/** What the colours of a view mean, and that what it shows is not known. refined: it may come yet. */
export function showMeaning(view: FaceView, refined: boolean): void {
  const legend = kLegends[view.view];
  const known = view.isKnown(view.view);
  const unknown = element('unknown');
  unknown.hidden = known;
  const told = known ? '' : text(refined ? 'unknown_yet' : 'unknown_off', {
    what: text(`view_${view.view}`) });
  if (unknown.textContent !== told) {
    unknown.textContent = told;
  }
  const place = element('legend');
  place.hidden = !legend || !known;
  const keys = legend ? [legend.grey, legend.from, legend.to] : [];
  const shown = keys.map((key) => (key ? text(key) : '')).join();
  if (legend && place.dataset.shown !== shown) {
    place.dataset.shown = shown;
    const swatch = (ramp: string) => {
      const colour = document.createElement('i');
      colour.className = ramp === '' ? '' : 'ramp';
      colour.style.setProperty('--ramp', ramp);
      return colour;
    };
    const words = (key: Key) => {
      const where = document.createElement('span');
      where.textContent = text(key);
      return where;
    };
    place.replaceChildren(...(legend.ball ? [ball(), words(legend.from), words(legend.to)] : legend.grey ? [swatch(''), words(legend.grey), words(legend.from), swatch(legend.ramp), words(legend.to)]
      : [words(legend.from), swatch(legend.ramp), words(legend.to)]));
  }
}

/** Keeps what may be scrolled further marked, so that it is seen without touching it. */
export function watchOverflow(): void {
  const watch = new ResizeObserver(markOverflow);
  document.querySelectorAll('.scrolls').forEach((box) => watch.observe(box));
  document.addEventListener('scroll', markOverflow, { capture: true, passive: true });
}

/** What is in them may have grown, too. */
export function markOverflow(): void {
  for (const box of document.querySelectorAll<HTMLElement>('.scrolls')) {
    const style = getComputedStyle(box);
    const below = box.scrollHeight - box.clientHeight - box.scrollTop > 4;
    const right = box.scrollWidth - box.clientWidth - box.scrollLeft > 4;
    box.classList.toggle('more-below', below && style.overflowY === 'auto');
    box.classList.toggle('more-right', right && style.overflowX === 'auto');
    box.classList.toggle('more-left', box.scrollLeft > 4 && style.overflowX === 'auto');
  }
}
