// Looking needs a token where others than this machine are meant to reach the page (docs/web.md, "Who may do what").

/** 'open': looking needs none. 'later': too many wrong ones were shown, so that none is looked at now. 'unknown': nobody said. */
export type Opens = 'open' | 'look' | 'commands' | 'nothing' | 'later' | 'unknown';

/** What a token opens, which the browser then keeps as a cookie; '': what this browser may do without showing one. */
export async function opens(token: string): Promise<Opens> {
  try {
    const answer = await fetch('/look', { cache: 'no-store', headers: token === '' ? {} : { Authorization: `Bearer ${token}` } });
    if (answer.status === 401 || answer.status === 429) {
      return answer.status === 401 ? 'nothing' : 'later';
    }
    const word = answer.ok ? (await answer.text()).trim() : '';
    return word === 'look' || word === 'commands' || word === 'open' ? word : 'unknown';
  } catch {
    return 'unknown';
  }
}
