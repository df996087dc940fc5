// The expression's values as bars: left and right of one movement in one row, what moved most of late first.
import { element } from './panels';
import { number, text, valueText } from './text';

/** The order is looked at again so often, s. */
const kReorder_s = 2;
/** What a value reached is forgotten by half in so long, s. */
const kHalfLife_s = 20;
/** A row passes another only where it reached more by this: rows that do about the same stay. */
const kMargin = 0.05;

/** One row: a value alone, or the same movement of the left and the right side. Places among the names. */
export interface ValueRow {
  /** The name without its side. */
  base: string;
  places: [number] | [left: number, right: number];
}

/** The rows in the order of the names. What has no other side stands alone. */
export function rowsOf(names: string[]): ValueRow[] {
  const rows: ValueRow[] = [];
  const others: Record<string, string> = { Left: 'Right', Right: 'Left', L: 'R', R: 'L' };
  names.forEach((name, place) => {
    const [, base, side] = /^(.+?)_?(Left|Right|L|R)$/.exec(name) ?? [];
    const other = base === undefined ? -1
      : names.indexOf(name.slice(0, name.length - side.length) + others[side]);
    if (other < 0) {
      rows.push({ base: name, places: [place] });
    } else if (place < other) {
      rows.push({ base, places: side.startsWith('L') ? [place, other] : [other, place] });
    }
  });
  return rows;
}

/** An order by what was reached of late that does not jump. */
export class SlowOrder {
  private readonly most: number[];
  private order: number[];

  constructor(count: number) {
    this.most = new Array<number>(count).fill(0);
    this.order = this.most.map((_, i) => i);
  }

  /** sizes: as they are now, 0 and more; elapsed_s: since the last call. */
  add(sizes: number[], elapsed_s: number): void {
    const kept = 0.5 ** (elapsed_s / kHalfLife_s);
    sizes.forEach((size, i) => { this.most[i] = Math.max(size, kept * this.most[i]); });
  }

  /** The rows, what reached most first. */
  sorted(): readonly number[] {
    const order = this.order;
    for (let i = 1; i < order.length; ++i) {
      for (let at = i; at > 0 && this.most[order[at]] > this.most[order[at - 1]] + kMargin; --at) {
        [order[at - 1], order[at]] = [order[at], order[at - 1]];
      }
    }
    return order;
  }
}

interface Bar {
  track: HTMLElement;
  bar: HTMLElement;
  value: HTMLElement;
}

export class Expressions {
  private rows: (ValueRow & { row: HTMLElement; label: HTMLElement; bars: Bar[] })[] = [];
  private order = new SlowOrder(0);
  private last_ms = -Infinity;
  private ordered_ms = -Infinity;

  setNames(names: string[]): void {
    this.rows = rowsOf(names).map((entry) => {
      const row = document.createElement('div');
      row.className = entry.places.length === 2 ? 'bar pair' : 'bar';
      const [label, tracks, values] = ['span', 'div', 'div'].map((tag) => document.createElement(tag));
      label.title = entry.places.map((place) => names[place]).join(', ');
      const bars = entry.places.map((place) => {
        const track = document.createElement('i');
        track.setAttribute('role', 'meter');
        track.setAttribute('aria-label', names[place]);
        track.setAttribute('aria-valuemin', '0');
        track.setAttribute('aria-valuemax', '1');
        const bar = document.createElement('b');
        const value = document.createElement('output');
        track.append(bar);
        tracks.append(track);
        values.append(value);
        return { track, bar, value };
      });
      row.append(label, tracks, values);
      return { ...entry, row, label, bars };
    });
    this.order = new SlowOrder(this.rows.length);
    this.ordered_ms = -Infinity;
    element('expressions').replaceChildren(...this.rows.map(({ row }) => row));
    this.translate();
  }

  /** The words in the language of now. */
  translate(): void {
    const say = (where: HTMLElement, words: string) => {
      if (where.textContent !== words) {
        where.textContent = words;
      }
    };
    if (this.rows.length === 0) {
      say(element('expressions'), text('expression_none'));
    }
    this.rows.forEach(({ label, base }) => say(label, valueText(base)));
  }

  /** weights: [name]. told: also in numbers, and to those who hear the page. */
  show(weights: ArrayLike<number>, told: boolean): void {
    const now_ms = performance.now();
    const sizeAt = (place: number) => Math.abs(weights[place] ?? 0);
    const sizes = this.rows.map(({ places }) => Math.max(...places.map(sizeAt)));
    this.order.add(sizes, Number.isFinite(this.last_ms) ? (now_ms - this.last_ms) / 1000 : 0);
    this.last_ms = now_ms;
    if (now_ms - this.ordered_ms > 1000 * kReorder_s) {
      this.ordered_ms = now_ms;
      this.order.sorted().forEach((row, place) => { this.rows[row].row.style.order = String(place); });
    }
    for (const { places, bars } of this.rows) {
      bars.forEach(({ track, bar, value }, i) => {
        const weight = weights[places[i]] ?? 0;
        bar.style.transform = `scaleX(${Math.min(1, Math.abs(weight)).toFixed(3)})`;
        bar.classList.toggle('negative', weight < 0);
        if (told) {
          value.textContent = number(weight, 2);
          track.setAttribute('aria-valuenow', weight.toFixed(2));
        }
      });
    }
  }
}
