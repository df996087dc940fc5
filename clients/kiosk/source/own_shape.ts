// The ring that fills while a head turns before the camera, and the way to keep whose shape it shows (docs/person.md, "Live, unasked").
import { element } from './panels';
import type { Learning } from './status';
import { number, text, type Key } from './text';

const kSectors = 24;
/** Radii in the ring's drawing: of what was not turned at all, and of what was turned far enough. */
const kInner = 24;
const kOuter = 46;

/** For each sector of directions, clockwise from above as the person before the camera sees it, how far the head was turned there
    [0 to 1]. seen_deg: yaw and pitch of the camera in the head's axes: a head that turns to its left has the camera at its right. */
export function turnedBySector(seen_deg: [number, number][], needed_deg: number): number[] {
  const turned = new Array<number>(kSectors).fill(0);
  for (const [yaw, pitch] of seen_deg) {
    const far = Math.hypot(yaw, pitch) / needed_deg;
    const around = Math.atan2(yaw, -pitch) / (2 * Math.PI); // to the head's right: a quarter
    const sector = ((Math.round(around * kSectors) % kSectors) + kSectors) % kSectors;
    for (const near of [sector - 1, sector, sector + 1]) {
      const at = (near + kSectors) % kSectors;
      turned[at] = Math.max(turned[at], Math.min(1, far));
    }
  }
  return turned;
}

function sectorPath(sector: number, outer: number): string {
  const half = (0.42 * 2 * Math.PI) / kSectors;
  const middle = (sector * 2 * Math.PI) / kSectors;
  const at = (radius: number, angle: number) => `${(radius * Math.sin(angle)).toFixed(2)} ${(-radius * Math.cos(angle)).toFixed(2)}`;
  return `M${at(kInner, middle - half)} L${at(outer, middle - half)} A${outer} ${outer} 0 0 1 ${at(outer, middle + half)} ` +
    `L${at(kInner, middle + half)} A${kInner} ${kInner} 0 0 0 ${at(kInner, middle - half)} Z`;
}

/** What is to be done next, or goes on. */
function step({ state, turned_left_deg: left, turned_right_deg: right, needed_deg: needed }: Learning): Key {
  if (state !== 'looking') {
    return state === 'learned' ? 'shape_learned' : 'shape_solving';
  }
  return left < needed && right < needed ? 'shape_turn' : left < needed ? 'shape_turn_left' : right < needed ? 'shape_turn_right' : 'shape_hold';
}

export class OwnShape {
  private readonly petals: { room: SVGPathElement; turned: SVGPathElement }[] = [];

  /** keep: asks for the person's name. */
  constructor(keep: () => void) {
    const ring = element('shape-ring');
    for (let sector = 0; sector < kSectors; ++sector) {
      const [room, turned] = ['room', 'turned'].map((name) => {
        const path = document.createElementNS('http://www.w3.org/2000/svg', 'path');
        path.setAttribute('class', name);
        ring.append(path);
        return path;
      });
      room.setAttribute('d', sectorPath(sector, kOuter));
      this.petals.push({ room, turned });
    }
    element('shape-keep').addEventListener('click', keep);
  }

  /** null: no shape is learned here. */
  show(learning: Learning | null): void {
    const whole = element('shape');
    whole.hidden = learning === null;
    if (!learning) {
      return;
    }
    whole.dataset.state = learning.state;
    turnedBySector(learning.seen_deg, learning.needed_deg).forEach((part, sector) => {
      const { turned } = this.petals[sector];
      turned.setAttribute('d', part > 0 ? sectorPath(sector, kInner + part * (kOuter - kInner)) : '');
      turned.classList.toggle('enough', part >= 1);
    });
    element('shape-ring').setAttribute('aria-label', text('shape_label', {
      left: number(learning.turned_left_deg), right: number(learning.turned_right_deg), needed: number(learning.needed_deg) }));
    // Why nothing was learned, or what waits, is the daemon's to say.
    const words = [text(step(learning)), learning.note].filter(Boolean).join('. ');
    if (element('shape-step').textContent !== words) {
      element('shape-step').textContent = words;
    }
    element('shape-keep').hidden = learning.state !== 'learned';
  }
}
