// What the page says, in the language of whoever stands before it. One message file a language.
import de from './messages/de.json';
import en from './messages/en.json';

export type Key = keyof typeof en;
const languages: Record<string, Record<Key, string>> = { en, de };
let language = 'en';

export function chooseLanguage(wanted: string | null): void {
  const short = (wanted ?? navigator.language).slice(0, 2);
  language = short in languages ? short : 'en';
  document.documentElement.lang = language;
}

/** The other language of the two. */
export function otherLanguage(): string {
  return language === 'en' ? 'de' : 'en';
}

/** A message, with its {names} filled in. */
export function text(key: Key, values: Record<string, string | number> = {}): string {
  return languages[language][key].replace(/\{(\w+)\}/g, (_, name: string) => String(values[name] ?? ''));
}

/** The word for a state of the daemon; one that is not known stands for itself. */
export function stateText(state: string): string {
  const key = `state_${state}`;
  return key in en ? text(key as Key) : state;
}

/** A value of the expression in words; one without words of its own is its name, taken apart. */
export function valueText(name: string): string {
  const key = `value_${name}`;
  const apart = () => name.replace(/_/g, ' ').replace(/([a-z])([A-Z])/g, '$1 $2').toLowerCase();
  return key in en ? text(key as Key) : apart();
}

export function number(value: number, digits = 0): string {
  return value.toLocaleString(language, { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

export function bytes(value: number): string {
  return value < 1e6 ? `${number(value / 1e3)}\u00a0kB` : value < 1e9 ? `${number(value / 1e6, 1)}\u00a0MB` : `${number(value / 1e9, 2)}\u00a0GB`;
}

export function duration(seconds: number): string {
  const whole = Math.floor(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, '0')}`;
}

export function dateTime(utc: string): string {
  const date = new Date(utc);
  return Number.isNaN(date.getTime()) ? utc : date.toLocaleString(language, { month: 'short', day: 'numeric', hour: 'numeric', minute: '2-digit' });
}

/** What the daemon says, which it says in English. */
export function said(words: string): string {
  return words === '' ? '' : text('said', { words });
}
