// What is done with takes that are recorded: another name, notes and the slate, a part as a new take, deleted and brought back
// (takes.* of docs/control-protocol.md).
import { element } from './panels';
import type { Take, Takes, TrimStatus } from './status';
import { number, said, text } from './text';

/** So long a deleted take can be brought back by one press. The daemon keeps it for days. */
const kUndo_ms = 10_000;
/** What is left of a take has at least this length, s. */
const kShortest_s = 0.01;

export interface TakeHands {
  /** Whoever is at the page has shown the token. */
  mayCommand: () => boolean;
  /** Calls a method: null where it is done, else why not, in the daemon's words; "" where the token is missing, which is asked
      for then. */
  attempt: (method: string, params: object) => Promise<string | null>;
  tell: (title: string, help?: string) => void;
  /** Asks the daemon how it does, now. */
  look: () => Promise<void>;
}

const input = (id: string) => element<HTMLInputElement>(id);
const dialog = (id: string) => element<HTMLDialogElement>(id);

function setText(id: string, words: string): void {
  if (element(id).textContent !== words) {
    element(id).textContent = words;
    element(id).title = words; // it may be too long for its place
  }
}

export class TakeCare {
  private takes: Take[] = [];
  /** Of the dialog that is open. */
  private edited: Take | null = null;
  private trimmed = '';
  private length_s = 0;
  /** The new take of the trim that this page began, until it is told what became of it. */
  private awaited = '';
  private deleted = '';
  private undoTimer = 0;

  constructor(private readonly hands: TakeHands) {
    element('takes').addEventListener('click', (event) => {
      const button = (event.target as HTMLElement).closest<HTMLElement>('[data-action=edit]');
      const take = this.takes.find((one) => one.name === button?.dataset.take);
      if (take) {
        this.edit(take);
      }
    });
    element('take-form').addEventListener('submit', (event) => {
      event.preventDefault();
      void this.save();
    });
    element('take-trim').addEventListener('click', () => {
      const take = this.edited;
      dialog('take-dialog').close();
      if (take) {
        this.openTrim(take.name, take.duration_s ?? 0, 0, take.duration_s ?? 0);
      }
    });
    element('take-delete').addEventListener('click', () => { void this.remove(); });
    element('take-cancel').addEventListener('click', () => dialog('take-dialog').close());
    element('trim-form').addEventListener('submit', (event) => {
      event.preventDefault();
      void this.trim();
    });
    element('trim-cancel').addEventListener('click', () => dialog('trim-dialog').close());
    for (const end of ['from', 'to'] as const) {
      for (const id of [`trim-${end}`, `trim-${end}-slider`]) {
        input(id).addEventListener('input', () => this.showSpan(end, input(id).valueAsNumber));
      }
    }
    element('undo-button').addEventListener('click', () => { void this.undo(); });
    element('trimming-cancel').addEventListener('click', () => { void this.hands.attempt('takes.cancel', {}); });
  }

  /** What the daemon says; takes: null where that is not known. */
  show(takes: Takes | null, trim: TrimStatus | null): void {
    this.takes = takes?.takes ?? [];
    const may = this.hands.mayCommand();
    const works = trim?.state === 'working';
    element('trimming').hidden = !works;
    if (works) {
      setText('trimming-text', text('trim_works', { name: trim.take, part: number((100 * trim.done) / Math.max(1, trim.total)) }));
    }
    for (const id of ['undo-button', 'trimming-cancel']) {
      element<HTMLButtonElement>(id).disabled = !may;
      element(id).title = may ? '' : text('needs_token');
    }
    if (this.deleted !== '') {
      setText('undo-text', text('take_deleted', { name: this.deleted }));
    }
    if (trim && trim.to === this.awaited && !works) {
      this.awaited = '';
      if (trim.state === 'done') {
        this.hands.tell(text('trim_done', { name: trim.to }));
      } else {
        this.hands.tell(text('trim_failed', { name: trim.take }), trim.reason === '' ? '' : said(trim.reason));
      }
    }
  }

  private edit(take: Take): void {
    this.edited = take;
    const readable = take.error === undefined;
    element('take-title').textContent = text('take_title', { name: take.name });
    input('take-name').value = take.name;
    input('take-scene').value = take.slate?.scene ?? '';
    input('take-number').value = take.slate?.take ?? '';
    element<HTMLTextAreaElement>('take-note').value = take.note ?? '';
    element('take-words').hidden = !readable;
    element<HTMLButtonElement>('take-trim').hidden = !readable;
    setText('take-from', take.cut_from === undefined ? '' : text('take_from', { from: take.cut_from }));
    this.tellIn('take', null);
    dialog('take-dialog').showModal();
  }

  /** Why a dialog did not do what it was asked for; it stays open then. */
  private tellIn(which: 'take' | 'trim', why: string | null): void {
    element(`${which}-wrong`).hidden = !why;
    setText(`${which}-wrong`, why ? said(why) : '');
  }

  /** Words first: under the old name they are certainly there. */
  private async save(): Promise<void> {
    const take = this.edited;
    if (!take) {
      return;
    }
    const words = {
      note: element<HTMLTextAreaElement>('take-note').value.trim(),
      slate: { scene: input('take-scene').value.trim(), take: input('take-number').value.trim() } };
    const changed = words.note !== (take.note ?? '') || words.slate.scene !== (take.slate?.scene ?? '')
      || words.slate.take !== (take.slate?.take ?? '');
    const name = input('take-name').value.trim();
    let why = changed ? await this.hands.attempt('takes.note', { name: take.name, ...words }) : null;
    if (why === null && name !== take.name) {
      why = await this.hands.attempt('takes.rename', { name: take.name, to: name });
    }
    this.tellIn('take', why);
    if (why === null) {
      dialog('take-dialog').close();
    }
    await this.hands.look();
  }

  private async remove(): Promise<void> {
    const name = this.edited?.name ?? '';
    const why = await this.hands.attempt('takes.delete', { name });
    this.tellIn('take', why);
    if (why !== null) {
      return;
    }
    dialog('take-dialog').close();
    this.deleted = name;
    setText('undo-text', text('take_deleted', { name }));
    element('undo').hidden = false;
    element('undo-button').focus();
    window.clearTimeout(this.undoTimer);
    this.undoTimer = window.setTimeout(() => this.forget(), kUndo_ms);
    await this.hands.look();
  }

  private forget(): void {
    this.deleted = '';
    element('undo').hidden = true;
    window.clearTimeout(this.undoTimer);
  }

  private async undo(): Promise<void> {
    const name = this.deleted;
    this.forget();
    const why = await this.hands.attempt('takes.restore', { name });
    this.hands.tell(text(why === null ? 'take_restored' : 'take_not_restored', { name }), why ? said(why) : '');
    await this.hands.look();
  }

  /** Asks for the part of a take that becomes a new one. Times as a replay counts them. */
  openTrim(name: string, length_s: number, from_s: number, to_s: number): void {
    this.trimmed = name;
    this.length_s = length_s;
    element('trim-title').textContent = text('trim_title', { name });
    const stem = `${name}-${text('trim_part')}`;
    let free = stem;
    for (let count = 2; this.takes.some((take) => take.name === free); ++count) {
      free = `${stem}-${count}`;
    }
    input('trim-name').value = free;
    for (const id of ['trim-from', 'trim-to', 'trim-from-slider', 'trim-to-slider']) {
      input(id).max = String(Math.ceil(100 * length_s) / 100);
    }
    input('trim-to').value = String(Math.ceil(100 * to_s) / 100);
    this.showSpan('from', from_s);
    this.tellIn('trim', null);
    dialog('trim-dialog').showModal();
  }

  /** One end of the span was moved; the other gives way. */
  private showSpan(moved: 'from' | 'to', at_s: number): void {
    const most = Number(input('trim-to').max);
    const limited = (value: number, least: number, high: number) => Math.round(100 * Math.max(least, Math.min(high, value))) / 100;
    let [from_s, to_s] = [input('trim-from').valueAsNumber || 0, input('trim-to').valueAsNumber || 0];
    if (Number.isNaN(at_s)) {
      element<HTMLButtonElement>('trim-do').disabled = true; // a field that is being typed in
      return;
    }
    if (moved === 'from') {
      from_s = limited(at_s, 0, most - kShortest_s);
      to_s = limited(to_s, from_s + kShortest_s, most);
    } else {
      to_s = limited(at_s, kShortest_s, most);
      from_s = limited(from_s, 0, to_s - kShortest_s);
    }
    for (const [end, value] of [['from', from_s], ['to', to_s]] as const) {
      for (const id of [`trim-${end}`, `trim-${end}-slider`]) {
        if (input(id) !== document.activeElement || input(id).type === 'range') {
          input(id).value = String(value);
        }
      }
    }
    element<HTMLButtonElement>('trim-do').disabled = most <= 0;
    setText('trim-length', text('trim_length', { length: number(to_s - from_s, 2), total: number(this.length_s, 2) }));
  }

  private async trim(): Promise<void> {
    const to = input('trim-name').value.trim();
    const why = await this.hands.attempt('takes.trim', {
      name: this.trimmed, from_s: input('trim-from-slider').valueAsNumber, to_s: input('trim-to-slider').valueAsNumber, to });
    this.tellIn('trim', why);
    if (why === null) {
      this.awaited = to;
      dialog('trim-dialog').close();
    }
    await this.hands.look();
  }
}
