// How avatars follow the face, changed while it is watched: each value's gain, dead zone and smoothing (values.* of
// docs/control-protocol.md), formulas (mapping.*), and a cartoon head that moves as they say.
import type { Frame } from '../generated/facet/stream/wire/frame';
import type { ControlConnection } from './connection';
import { rowsOf } from './expressions';
import { element } from './panels';
import { kArkitNames, Puppet, type Values } from './puppet';
import type { Tuning } from './status';
import { number, said, text, valueText, type Key } from './text';

const kLook_ms = 150;
/** Who types is asked no more often than this whether it is a formula. */
const kTyping_ms = 250;
const kAll = 'all';
const kPlain: Tuning = { gain: 1, dead_zone: 0, smoothing_ms: 0 };
type Table = 'vmc' | 'vrchat' | 'vtube_studio';
const kTables: Table[] = ['vmc', 'vrchat', 'vtube_studio'];

/** What a slider of a value sets. */
const kSliders: { key: keyof Tuning; words: Key; most: number; step: number; digits: number }[] = [
  { key: 'gain', words: 'avatar_gain', most: 4, step: 0.05, digits: 2 },
  { key: 'dead_zone', words: 'avatar_dead_zone', most: 0.9, step: 0.01, digits: 2 },
  { key: 'smoothing_ms', words: 'avatar_smoothing', most: 500, step: 5, digits: 0 }];

type Mapping = { file: string | null; saved: boolean } & Record<Table, { name: string; formula: string }[]>;

export interface AvatarHands {
  /** Whoever is at the page has shown the token. */
  mayCommand: () => boolean;
  /** Calls a method: null where it is done, else why not, in the daemon's words; "" where the token is missing. */
  attempt: (method: string, params: object) => Promise<string | null>;
  unlock: () => void;
}

function made<Tag extends keyof HTMLElementTagNameMap>(tag: Tag, className = ''): HTMLElementTagNameMap[Tag] {
  const node = document.createElement(tag);
  node.className = className;
  return node;
}

/** A bar from 0 to 1, or to the left below 0, and its number. */
class Meter {
  readonly node = made('div', 'meter');
  private readonly bar = made('b');
  private readonly value = made('output');

  constructor(name: string) {
    const track = made('i');
    track.setAttribute('role', 'meter');
    track.setAttribute('aria-label', name);
    track.append(this.bar);
    this.node.append(track, this.value);
  }

  show(value: number): void {
    this.bar.style.transform = `scaleX(${Math.min(1, Math.abs(value)).toFixed(3)})`;
    this.bar.classList.toggle('negative', value < 0);
    this.value.textContent = number(value, 2);
    this.node.firstElementChild!.setAttribute('aria-valuenow', value.toFixed(2));
  }
}

/** One value, or both sides of one: its bars and sliders. */
class ValueRow {
  readonly node = made('div', 'value');
  private readonly meters: Meter[];
  private readonly sliders = new Map<keyof Tuning, { input: HTMLInputElement; output: HTMLOutputElement }>();

  /** names: that are set together; base: as people call them. */
  constructor(private readonly names: string[], base: string, changed: (names: string[], key: keyof Tuning, to: number) => void) {
    const title = made('b');
    title.textContent = base === kAll ? text('avatar_all') : valueText(base);
    title.title = names.join(', ');
    this.meters = base === kAll ? [] : names.map((name) => new Meter(name));
    const meters = made('div', 'meters');
    meters.append(...this.meters.map((meter) => meter.node));
    this.node.dataset.name = names[0];
    this.node.append(title, meters);
    for (const { key, words, most, step } of kSliders) {
      const label = made('label');
      const input = made('input');
      Object.assign(input, { type: 'range', min: '0', max: String(most), step: String(step) });
      input.dataset.key = key;
      input.setAttribute('aria-label', text('avatar_of', { what: text(words), name: title.textContent ?? '' }));
      const caption = made('span');
      const output = made('output');
      caption.append(`${text(words)} `, output);
      label.append(caption, input);
      input.addEventListener('input', () => {
        this.tell(key, input.valueAsNumber);
        changed(names, key, input.valueAsNumber);
      });
      this.sliders.set(key, { input, output });
      this.node.append(label);
    }
  }

  private tell(key: keyof Tuning, value: number): void {
    this.sliders.get(key)!.output.textContent = number(value, kSliders.find((slider) => slider.key === key)!.digits);
  }

  /** tunings: those of the daemon; a slider that is held stays where the hand has it. */
  showTuning(tunings: Record<string, Tuning>, mayCommand: boolean): void {
    const tuning = tunings[this.names[0]] ?? tunings[kAll] ?? kPlain;
    for (const [key, { input }] of this.sliders) {
      input.disabled = !mayCommand;
      if (!input.matches(':active')) {
        const slider = kSliders.find((one) => one.key === key)!;
        input.max = String(Math.max(slider.most, tuning[key])); // by other hands it may be more
        input.value = String(tuning[key]);
        this.tell(key, tuning[key]);
      }
    }
  }

  showValues(values: Values): void {
    this.meters.forEach((meter, i) => meter.show(values[this.names[i]] ?? 0));
  }
}

/** A name and its formula, sent as it is typed; the last one of a table is for a new name. */
class FormulaRow {
  readonly node = made('li');
  readonly formula = made('input', 'formula');
  private readonly wrong = made('p', 'wrong');
  readonly meter: Meter;
  private timer = 0;

  constructor(readonly name: string, given: string, private readonly set: (name: string, formula: string) => Promise<string | null>, remove: (name: string) => void) {
    const title = made('b');
    title.textContent = title.title = name;
    this.meter = new Meter(name);
    this.formula.value = given;
    this.formula.spellcheck = false;
    this.formula.setAttribute('aria-label', text('avatar_formula_of', { name }));
    this.formula.addEventListener('input', () => {
      window.clearTimeout(this.timer);
      this.timer = window.setTimeout(() => { void this.send(); }, kTyping_ms);
    });
    const gone = made('button', 'quiet');
    gone.type = 'button';
    gone.textContent = '×';
    gone.setAttribute('aria-label', text('avatar_remove', { name }));
    gone.addEventListener('click', () => remove(name));
    this.wrong.setAttribute('role', 'alert');
    this.wrong.hidden = true;
    this.node.append(title, this.meter.node, this.formula, gone, this.wrong);
  }

  private async send(): Promise<void> {
    const why = await this.set(this.name, this.formula.value);
    this.wrong.hidden = why === null;
    this.wrong.textContent = why ? said(why) : '';
    this.formula.setAttribute('aria-invalid', String(why !== null));
  }

  /** What the daemon has, unless somebody types, or what was typed is no formula. */
  show(formula: string, mayCommand: boolean): void {
    this.formula.disabled = !mayCommand;
    for (const button of this.node.querySelectorAll('button')) {
      button.disabled = !mayCommand;
    }
    if (document.activeElement !== this.formula && this.wrong.hidden) {
      this.formula.value = formula;
    }
  }
}

/** The fields for a name that is not there yet. */
class NewRow {
  readonly node = made('li', 'new');
  private readonly name = made('input');
  private readonly formula = made('input', 'formula');
  private readonly add = made('button');
  private readonly wrong = made('p', 'wrong');

  constructor(table: Table, private readonly set: (name: string, formula: string) => Promise<string | null>) {
    const form = made('form');
    for (const [input, words, label] of [[this.name, 'avatar_name', 'avatar_new_name'], [this.formula, 'avatar_formula', 'avatar_new_formula']] as const) {
      input.placeholder = text(words);
      input.spellcheck = false;
      input.autocomplete = 'off';
      input.setAttribute('aria-label', text(label, { table: text(`avatar_${table}`) }));
    }
    this.add.textContent = text('avatar_add');
    this.wrong.setAttribute('role', 'alert');
    this.wrong.hidden = true;
    form.append(this.name, this.formula, this.add, this.wrong);
    form.addEventListener('submit', (event) => {
      event.preventDefault();
      void this.send();
    });
    this.node.append(form);
  }

  private async send(): Promise<void> {
    const why = await this.set(this.name.value.trim(), this.formula.value);
    this.wrong.hidden = why === null;
    this.wrong.textContent = why ? said(why) : '';
    if (why === null) {
      this.name.value = this.formula.value = '';
      this.name.focus();
    }
  }

  show(mayCommand: boolean): void {
    this.name.disabled = this.formula.disabled = this.add.disabled = !mayCommand;
  }
}

export class AvatarDesk {
  private puppet: Puppet | null = null;
  private names: string[] = [];
  private tunings: Record<string, Tuning> = {};
  private valueRows: ValueRow[] = [];
  private readonly formulaRows: Record<Table, FormulaRow[]> = { vmc: [], vrchat: [], vtube_studio: [] };
  private readonly newRows: Partial<Record<Table, NewRow>> = {};
  private mapping: Mapping | null = null;
  private told = '';
  private looking = false;
  private timer = 0;
  private lastMeters_ms = 0;
  /** What waits to be sent: of each value and slider the newest place. */
  private readonly waiting = new Map<string, { method: string; params: object }>();
  private sending = false;

  constructor(private readonly control: ControlConnection, private readonly hands: AvatarHands) {
    const dialog = element<HTMLDialogElement>('avatar-dialog');
    element('avatar-open').addEventListener('click', () => this.open());
    element('avatar-close').addEventListener('click', () => dialog.close());
    dialog.addEventListener('close', () => window.clearInterval(this.timer));
    element('avatar-unlock').addEventListener('click', () => hands.unlock());
    element('avatar-save').addEventListener('click', () => { void this.save(); });
    element('avatar-reset').addEventListener('click', () => { void this.reset(); });
    element('avatar-together').addEventListener('change', () => this.makeValueRows());
    element('avatar-show-values').addEventListener('click', () => this.choose('values'));
    element('avatar-show-formulas').addEventListener('click', () => this.choose('formulas'));
    this.choose('values');
  }

  get isOpen(): boolean {
    return element<HTMLDialogElement>('avatar-dialog').open;
  }

  private open(): void {
    element<HTMLDialogElement>('avatar-dialog').showModal();
    try {
      this.puppet ??= new Puppet(element<HTMLCanvasElement>('avatar'));
    } catch {
      this.puppet = null; // no WebGL 2: the numbers are to be seen all the same
    }
    this.told = '';
    this.makeRows();
    this.timer = window.setInterval(() => { void this.look(); }, kLook_ms);
    void this.look();
  }

  private choose(what: 'values' | 'formulas'): void {
    for (const one of ['values', 'formulas'] as const) {
      element(`avatar-${one}`).hidden = one !== what;
      element(`avatar-show-${one}`).setAttribute('aria-pressed', String(one === what));
    }
    element('avatar-both').hidden = what !== 'values';
  }

  /** In the language of now. */
  private makeRows(): void {
    element('avatar').setAttribute('aria-label', text('avatar_label'));
    this.makeValueRows();
    for (const table of kTables) {
      this.formulaRows[table] = [];
      this.newRows[table] = new NewRow(table, (name, formula) => this.map(table, name, formula));
      element(`avatar-${table}`).replaceChildren(this.newRows[table]!.node);
    }
    this.showMapping();
  }

  private makeValueRows(): void {
    const together = element<HTMLInputElement>('avatar-together').checked;
    const rows = together ? rowsOf(kArkitNames).map(({ base, places }) => ({ base, names: places.map((place) => kArkitNames[place]) }))
      : kArkitNames.map((name) => ({ base: name, names: [name] }));
    const changed = (names: string[], key: keyof Tuning, to: number) => names.forEach((name) => this.tune(name, key, to));
    this.valueRows = [{ base: kAll, names: [kAll] }, ...rows].map(({ base, names }) => new ValueRow(names, base, changed));
    element('avatar-values').replaceChildren(...this.valueRows.map((row) => row.node));
    this.showTunings();
  }

  private tune(name: string, key: keyof Tuning, to: number): void {
    const before = this.tunings[name] ?? this.tunings[kAll] ?? kPlain;
    this.tunings = { ...this.tunings, [name]: { ...before, [key]: to } };
    this.waiting.set(`${name} ${key}`, { method: 'values.set', params: { name, [key]: to } });
    void this.send();
  }

  private async send(): Promise<void> {
    if (this.sending) {
      return;
    }
    this.sending = true;
    for (const [key, { method, params }] of this.waiting) {
      this.waiting.delete(key);
      const why = await this.hands.attempt(method, params);
      this.told = why ? said(why) : '';
    }
    this.sending = false;
    this.showState();
  }

  private async map(table: Table, name: string, formula: string): Promise<string | null> {
    this.told = '';
    const why = await this.hands.attempt('mapping.set', { table, name, formula });
    await this.look();
    return why;
  }

  private async unmap(table: Table, name: string): Promise<void> {
    const why = await this.hands.attempt('mapping.unset', { table, name });
    this.told = why ? said(why) : '';
    await this.look();
  }

  private async save(): Promise<void> {
    const why = await this.hands.attempt('mapping.save', {});
    this.told = why === null ? '' : text('avatar_not_saved', { why: said(why) });
    await this.look();
    if (why === null) {
      this.told = text('avatar_saved', { file: this.mapping?.file ?? '' });
      this.showState();
    }
  }

  private async reset(): Promise<void> {
    for (const method of ['values.reset', 'mapping.reset']) {
      const why = await this.hands.attempt(method, {});
      this.told = why ? said(why) : '';
    }
    this.makeRows();
    await this.look();
  }

  /** tunings: of the status. */
  show(tunings: Record<string, Tuning> | undefined): void {
    if (!this.sending) {
      this.tunings = tunings ?? {};
    }
    if (this.isOpen) {
      this.showTunings();
    }
  }

  setNames(names: string[]): void {
    this.names = names.map((name) => name.charAt(0).toLowerCase() + name.slice(1));
  }

  take(frame: Frame): void {
    const values = frame.avatarValuesArray() ?? frame.expressionArray();
    const camera_from_head = frame.cameraFromHead();
    if (!this.isOpen || !values || !camera_from_head) {
      return;
    }
    const byName: Values = Object.fromEntries(this.names.map((name, i) => [name, values[i]]));
    this.puppet?.show(byName, Array.from({ length: 12 }, (_, i) => camera_from_head.bb!.readFloat32(camera_from_head.bb_pos + 4 * i)));
    const now = performance.now();
    if (now - this.lastMeters_ms > 90) {
      this.lastMeters_ms = now;
      this.valueRows.forEach((row) => row.showValues(byName));
    }
  }

  /** Asks the daemon for its formulas and what comes of them. */
  private async look(): Promise<void> {
    if (this.looking) {
      return;
    }
    this.looking = true;
    try {
      this.mapping = await this.control.call<Mapping>('mapping.get');
      if (!element('avatar-formulas').hidden) {
        const values = await this.control.call<Record<Table, Values>>('mapping.values');
        kTables.forEach((table) => this.formulaRows[table].forEach((row) => row.meter.show(values[table][row.name] ?? 0)));
      }
    } catch {
      this.mapping = null;
    }
    this.looking = false;
    this.showMapping();
  }

  private showTunings(): void {
    this.valueRows.forEach((row) => row.showTuning(this.tunings, this.hands.mayCommand()));
    this.showState();
  }

  private showMapping(): void {
    const may = this.hands.mayCommand();
    for (const table of kTables) {
      const wanted = this.mapping?.[table] ?? [];
      const rows = this.formulaRows[table];
      if (rows.map((row) => row.name).join('\n') !== wanted.map((one) => one.name).join('\n')) {
        this.formulaRows[table] = wanted.map(({ name, formula }) => rows.find((row) => row.name === name) ?? new FormulaRow(
          name, formula, (of, given) => this.map(table, of, given), (of) => { void this.unmap(table, of); }));
        const fresh = this.formulaRows[table].map((row) => row.node);
        rows.filter((row) => !this.formulaRows[table].includes(row)).forEach((row) => row.node.remove());
        fresh.forEach((node) => this.newRows[table]?.node.before(node));
      }
      wanted.forEach(({ formula }, i) => this.formulaRows[table][i].show(formula, may));
      this.newRows[table]?.show(may);
    }
    this.showState();
  }

  private showState(): void {
    const may = this.hands.mayCommand();
    const saved = this.mapping?.saved ?? true;
    const words = this.told !== '' ? this.told : !may ? text('avatar_locked') : saved ? '' : text('avatar_unsaved');
    if (element('avatar-state').textContent !== words) {
      element('avatar-state').textContent = words;
    }
    element('avatar-unlock').hidden = may;
    element<HTMLButtonElement>('avatar-save').disabled = !may || saved;
    element<HTMLButtonElement>('avatar-reset').disabled = !may || saved;
  }
}
