// The page of a capture booth: brings what the daemon sends to the view and the cards, and what is pressed to the daemon.
import type { Frame } from '../generated/facet/stream/wire/frame';
import { Profile } from '../generated/facet/stream/wire/profile';
import { AvatarDesk } from './avatar_desk';
import { Blend } from './blend';
import { ControlConnection, ControlError, StreamConnection, kPermissionDenied, kTooManyTokens } from './connection';
import { Expressions } from './expressions';
import { FaceView, kViews, type View } from './face_view';
import { opens } from './look_gate';
import { levelsOf, meshOf } from './meshes';
import { OwnShape } from './own_shape';
import { Plot, element, showCamera, showDevices, showTakes } from './panels';
import { Rebuilder } from './rebuild';
import { keepFree, markOverflow, showChosen, showMeaning, watchOverflow } from './stage';
import { baseName, type NamedDevice, type Recording, type Status, type Takes } from './status';
import { Studio } from './studio';
import { TakeCare } from './take_care';
import { chooseLanguage, duration, number, otherLanguage, said, stateText, text, type Key } from './text';

const kStatusPeriod_ms = 1000;
const kCountdown_s = 3;
const kRateWindow_ms = 2000;
/** Without a new mesh for so long the face counts as gone; where the tracker has lost it, sooner. */
const kPatience_ms = 6000;
const kLost_ms = 1000;
/** Pictures of the camera: in their card, and over the whole stage. */
const kCardImage_px = 480;
const kStageImage_px = 960;

/** The browser may forbid to keep anything. */
const memory = {
  get: (key: string): string => {
    try { return localStorage.getItem(key) ?? ''; } catch { return ''; }
  },
  set: (key: string, value: string): void => {
    try { localStorage.setItem(key, value); } catch { /* then not */ }
  },
};

let view: FaceView | null = null;
let studio: Studio | null = null;
let blend: Blend | null = null;
let rebuilder: Rebuilder | null = null; // null: the stream brings whole meshes
let connected = false;
let connectedSince_ms = 0;
let refusal = '';
let status: Status | null = null;
let takes: Takes | null = null;
let unlocked = false;
let hasSubject = false;
let tracking = -1; // of the newest frame: 0 searching, 1 acquiring, 2 tracking, 3 lost
let lastMesh_ms = -Infinity;
let vertices = 0;
let skipped = 0; // frames of the stream that this page was too slow for, since it connected
let neutralAsked = false;
let countdown = 0; // timer; 0: none runs
let notice: { title: string; help: string; until_ms: number } | null = null;
let recordWhenUnlocked = false;
const arrivals: number[] = [];
let latency_ms = 0;
let lastPanels_ms = 0;

const expressions = new Expressions();
const ownShape = new OwnShape(() => { void keepPerson(); });
const takeCare = new TakeCare({
  mayCommand: () => unlocked, attempt: (method, params) => attempt(method, params), tell: (title, help) => tell(title, help), look: () => look() });
const plots = [new Plot('rate', 'rate', '#7fd6c8', ''), new Plot('latency', 'latency', '#e0b062', ' ms')];

const stream = new StreamConnection({
  connected: () => {
    connected = true;
    connectedSince_ms = performance.now();
    skipped = 0;
    refusal = '';
    showState();
  },
  closed: (reason) => { connected = false; refusal = reason; arrivals.length = 0; showState(); },
  subject: (subject) => {
    const hierarchy = subject.hierarchy();
    const levels = hierarchy ? levelsOf(hierarchy) : [];
    if (levels.length === 0) {
      return;
    }
    vertices = levels[levels.length - 1].vertexCount();
    rebuilder = hierarchy ? Rebuilder.of(hierarchy) : null;
    view?.setSubject(levels.map((level) => level.trianglesArray()!), vertices);
    const names = Array.from({ length: subject.expressionNamesLength() }, (_, i) => subject.expressionNames(i) as string);
    expressions.setNames(names);
    avatar.setNames(names);
    hasSubject = true;
  },
  albedo: (albedo) => view?.setAlbedo(albedo.linearRgbArray()!, albedo.scale()),
  frame: showFrame,
  dropped: (total) => { skipped = total; },
});

const control = new ControlConnection(
  takeToken(),
  (code) => {
    unlocked = false;
    recordWhenUnlocked = false;
    memory.set('token', '');
    element('token-wrong').textContent = text(code === kTooManyTokens ? 'token_later' : 'token_wrong');
    element('token-wrong').hidden = false;
    openTokenDialog();
    showState();
  },
  () => { void look(); });

const avatar = new AvatarDesk(control, {
  mayCommand: () => unlocked, attempt: (method, params) => attempt(method, params), unlock: () => openTokenDialog() });

/** From the address (#token=..., which no server sees) or from an earlier visit. */
function takeToken(): string {
  const given = new URLSearchParams(location.hash.slice(1)).get('token');
  if (given) {
    memory.set('token', given);
    history.replaceState(null, '', location.pathname);
  }
  return given ?? memory.get('token');
}

/** The stream brings what is shown and no more: the coarse mesh costs this page some work with each frame. */
function wantOfStream(): void {
  const over = blend?.isOver === true;
  stream.want({
    profile: over || view?.view === 'relief' ? Profile.Displacements : Profile.Vertices,
    images: over || element('camera').clientWidth > 0, longestImage_px: over ? kStageImage_px : kCardImage_px });
}

function showFrame(frame: Frame): void {
  const now = performance.now();
  arrivals.push(now);
  while (arrivals.length > 0 && arrivals[0] < now - kRateWindow_ms) {
    arrivals.shift();
  }
  tracking = frame.state();
  latency_ms = frame.stageMs()?.latencyMs() ?? latency_ms;
  const mesh = hasSubject ? meshOf(frame, rebuilder) : null;
  blend?.take(frame, status?.rig === null);
  if (mesh) {
    // What can't be drawn is no live face; what the avatar covers needs no drawing.
    lastMesh_ms = !avatar.isOpen && view?.setMesh(mesh) === false ? lastMesh_ms : now;
  }
  avatar.take(frame);
  document.body.dataset.frames = String(Number(document.body.dataset.frames ?? 0) + 1);
  if (now - lastPanels_ms > 90) {
    const weights = frame.avatarValuesArray() ?? frame.expressionArray();
    if (weights) {
      expressions.show(weights, Math.floor(now / 500) !== Math.floor(lastPanels_ms / 500));
    }
    lastPanels_ms = now;
    showCamera(frame);
  }
  showState();
}

/** Asks the daemon how it does; for its takes where they are others than those that are known. One look at a time: who asks
    meanwhile gets another one after it. */
async function look(): Promise<void> {
  if (looking) {
    lookAgain = true;
    return looking;
  }
  looking = lookOnce();
  try {
    await looking;
  } finally {
    looking = null;
  }
  if (lookAgain) {
    lookAgain = false;
    await look();
  }
}
let looking: Promise<void> | null = null;
let lookAgain = false;
let takesList = -1; // Status.takes.list of `takes`

async function lookOnce(): Promise<void> {
  try {
    status = await control.call<Status>('status');
    if (control.token !== '' && !unlocked) {
      unlocked = true;
      memory.set('token', control.token);
      closeTokenDialog();
      if (recordWhenUnlocked) {
        recordWhenUnlocked = false;
        beginCountdown();
      }
    }
    wantOfStream();
    element('camera').classList.toggle('mirror', status.rig === null);
    studio?.show(status.studio);
    tellNeutral();
  } catch {
    status = null;
    takesList = -1;
  }
  showAll();
  if (status !== null && status.takes.list !== takesList) {
    try {
      const list = status.takes.list;
      takes = await control.call<Takes>('takes.list');
      takesList = list;
    } catch {
      return; // asked again with the next look; the rest of the page does not wait for it
    }
    showAll();
  }
}

interface Problem {
  title: string;
  help?: string;
  grave?: boolean;
}

/** What is shown is the face as it is now: also where a slow machine makes a mesh only every few seconds. */
function isFresh(): boolean {
  return performance.now() - lastMesh_ms < (tracking === 2 ? kPatience_ms : kLost_ms);
}

/** What keeps the face from being seen, in words; null where it is seen. */
function problem(): Problem | null {
  if (!view) {
    return { title: text('problem_webgl'), grave: true };
  }
  if (stream.foreign) {
    return { title: text('problem_version'), grave: true };
  }
  if (!connected) {
    return refusal !== '' && refusal !== 'the server stops'
      ? { title: text('problem_refused'), help: refusal, grave: true }
      : { title: text('problem_offline'), help: text('problem_offline_help'), grave: true };
  }
  if (status && !studio?.isOpen) {
    const cameras: NamedDevice[] = status.rig ? status.rig.cameras : status.camera ? [{ ...status.camera, name: text('device_camera') }] : [];
    const states: [string, Key, Key | null][] = [
      ['absent', 'problem_absent', 'problem_absent_help'], ['stalled', 'problem_stalled', null], ['failing', 'problem_failing', null]];
    for (const [state, title, help] of states) {
      const camera = cameras.find((entry) => entry.state === state);
      if (camera) {
        return { title: text(title, { camera: camera.name }), help: [camera.reason, help ? text(help) : ''].filter(Boolean).join('. '), grave: true };
      }
    }
    switch (status.state) {
      case 'failed':
        return { title: text('problem_failed'), help: status.reason, grave: true };
      case 'starting':
      case 'preparing':
        return { title: text('problem_starting'), help: text('problem_starting_help') };
      case 'ended':
        return { title: text('problem_ended'), help: status.reason };
      case 'waiting for a reader':
        return { title: text('problem_waiting') };
    }
    if (status.rig?.trigger?.state === 'failing') {
      return { title: text('problem_trigger'), help: status.rig.trigger.reason, grave: true };
    }
  }
  if (tracking === 1) {
    return { title: text('problem_acquiring'), help: text('problem_acquiring_help') }; // over the provisional mesh
  }
  if (isFresh()) {
    return null;
  }
  if (status?.mode === 'frames' && status.frames.processed > 0) {
    return { title: text('problem_no_mesh'), help: text('problem_no_mesh_help') };
  }
  if (tracking === 0 || tracking === 3) {
    return { title: text('problem_no_face'), help: text('problem_no_face_help') };
  }
  return status ? null : { title: text('problem_starting') };
}

function setText(id: string, words: string): void {
  const where = element(id);
  if (where.textContent !== words) {
    where.textContent = words;
  }
}

/** Frames that came in a second, over the last two. */
function rate(): number {
  const now = performance.now();
  const seconds = Math.min(kRateWindow_ms, now - connectedSince_ms) / 1000;
  return seconds < 0.5 ? 0 : arrivals.filter((at_ms) => at_ms > now - kRateWindow_ms).length / seconds;
}

function showState(): void {
  const now = performance.now();
  const live = connected && isFresh();
  document.body.dataset.connection = !connected ? 'offline' : live ? 'live' : 'idle';
  setText('state-text', text(!connected ? 'offline' : studio?.isOpen && studio.status?.state !== 'opening' ? 'studio' : live ? 'live' : 'idle'));
  let wrong: Problem | null = problem();
  if (notice && now < notice.until_ms) {
    wrong = wrong?.grave ? wrong : { title: notice.title, help: notice.help };
  }
  const banner = element('banner');
  banner.hidden = wrong === null;
  banner.classList.toggle('grave', wrong?.grave === true);
  setText('banner-title', wrong?.title ?? '');
  setText('banner-text', wrong?.help ?? '');
  element('face').classList.toggle('away', !live);
}

function showFigures(): void {
  const live = document.body.dataset.connection === 'live';
  setText('figures', live ? text('figures', { rate: number(rate(), rate() < 10 ? 1 : 0), latency: number(latency_ms), vertices: number(vertices) }) : '');
  if (connected) {
    plots[0].add(rate());
    if (live) {
      plots[1].add(latency_ms);
    }
  }
  plots.forEach((plot) => plot.show());
}

function showRecording(): void {
  const recording = status?.recording?.state === 'recording' ? status.recording : null;
  const button = element<HTMLButtonElement>('record');
  button.classList.toggle('on', recording !== null);
  button.disabled = !connected || !status;
  const isTaken = status?.bridges?.neutral.state === 'recording';
  element<HTMLButtonElement>('neutral').disabled = !connected || !unlocked || isTaken;
  setText('record-text', text(countdown !== 0 ? 'record_cancel' : recording ? 'record_stop' : 'record'));
  const chip = element('recording');
  chip.hidden = recording === null;
  if (recording) {
    setText('recording', text('recording_since', { name: baseName(recording.file), time: duration((performance.now() - recordingSince) / 1000) }));
  }
}
let recordingSince = 0;

function showAll(): void {
  document.querySelectorAll<HTMLElement>('[data-text]').forEach((where) => {
    const words = text(where.dataset.text as Key);
    if (where.textContent !== words) {
      where.textContent = words;
    }
  });
  setText('language', text('language'));
  element('language').setAttribute('aria-label', text('language_label'));
  setText('fullscreen', text('fullscreen'));
  setText('unlock', text(unlocked ? 'unlocked' : 'unlock'));
  element('unlock').classList.toggle('on', unlocked);
  element('unlock').setAttribute('aria-label', text(unlocked ? 'lock_label' : 'unlock_label'));
  element('views').setAttribute('aria-label', text('views'));
  for (const button of element('views').children) {
    const name = (button as HTMLElement).dataset.view as View;
    button.textContent = text(`view_${name}`);
    button.setAttribute('aria-pressed', String(view?.view === name));
  }
  element('face').setAttribute('aria-label', text('face_label', { state: stateText(['searching', 'acquiring', 'tracking', 'lost'][tracking] ?? 'starting') }));
  const detail = element('detail');
  detail.hidden = !view || view.detail <= (view.software ? 0 : 1);
  detail.dataset.level = String(view?.detail ?? 0);
  if (view) {
    setText('detail', text(view.software ? 'detail_software' : 'detail_slow'));
  }
  if (view) {
    showMeaning(view, (status?.gpu ?? '') !== '');
  }
  element('neutral').title = text(unlocked ? 'neutral_label' : 'needs_token');
  expressions.translate();
  showDevices(status, { unlocked, skipped });
  showTakes(takes, unlocked);
  blend?.show();
  takeCare.show(takes, status?.takes.trim ?? null);
  ownShape.show(status?.learning ?? null);
  studio?.draw();
  avatar.show(status?.bridges?.values);
  showState();
  showRecording();
}

/** Records the bridges' neutral pose; tellNeutral() says what came of it. */
async function recordNeutral(): Promise<void> {
  if (await command('neutral.record', {}, 'neutral_failed')) {
    neutralAsked = true;
    tell(text('neutral_recording'), text('neutral_help'));
    await look();
  }
}

function tellNeutral(): void {
  const neutral = status?.bridges?.neutral;
  if (neutralAsked && neutral && neutral.state !== 'recording') {
    neutralAsked = false;
    tell(text(neutral.state === 'set' ? 'neutral_set' : 'neutral_failed'), said(neutral.reason));
  }
}

function tell(title: string, help = ''): void {
  notice = { title, help, until_ms: performance.now() + 5000 };
  showState();
}

async function command<Result>(method: string, params: object = {}, failed: Key = 'record_failed'): Promise<Result | null> {
  try {
    return await control.call<Result>(method, params);
  } catch (error) {
    if (error instanceof ControlError && error.code === kPermissionDenied) {
      unlocked = false;
      openTokenDialog();
    } else {
      tell(text(failed), error instanceof Error ? said(error.message) : '');
    }
    return null;
  }
}

/** Calls a method: null where it is done, else why not, in the daemon's words; "" where the token is missing. */
async function attempt(method: string, params: object): Promise<string | null> {
  try {
    await control.call(method, params);
    return null;
  } catch (error) {
    if (error instanceof ControlError && error.code === kPermissionDenied) {
      unlocked = false;
      openTokenDialog();
      return '';
    }
    return error instanceof Error ? error.message : String(error);
  }
}

async function startRecording(): Promise<void> {
  recordingSince = performance.now();
  await command('record.start');
  await look();
}

async function stopRecording(): Promise<void> {
  const take = await command<Recording>('record.stop');
  if (take) {
    const doubtful = take.state === 'failed' || take.warning !== '';
    const title = text('recorded', { name: baseName(take.file), frames: number(take.frames) });
    tell(doubtful ? text('record_doubtful', { name: baseName(take.file) }) : title, said(take.reason || take.warning));
  }
  await look();
}

function beginCountdown(): void {
  let left = kCountdown_s;
  const show = element('countdown');
  const step = () => {
    show.hidden = left === 0;
    show.textContent = left === 0 ? '' : String(left);
    // The animation begins anew with each number.
    show.classList.remove('beat');
    void show.offsetWidth;
    show.classList.add('beat');
    if (left-- === 0) {
      endCountdown();
      void startRecording();
    }
  };
  countdown = window.setInterval(step, 1000);
  step();
  showRecording();
}

function endCountdown(): void {
  window.clearInterval(countdown);
  countdown = 0;
  element('countdown').hidden = true;
  showRecording();
}

function pressRecord(): void {
  if (countdown !== 0) {
    endCountdown();
  } else if (status?.recording?.state === 'recording') {
    void stopRecording();
  } else if (!unlocked) {
    recordWhenUnlocked = true;
    openTokenDialog();
  } else {
    beginCountdown();
  }
}

/** Asks for a name and has the daemon keep the person before the camera, who is the one that was there when it was asked. */
async function keepPerson(): Promise<void> {
  const subject = status?.learning?.subject;
  if (!unlocked) {
    openTokenDialog();
    return;
  }
  const dialog = element<HTMLDialogElement>('person-dialog');
  const name = element<HTMLInputElement>('person-name');
  name.value = '';
  dialog.returnValue = '';
  dialog.showModal();
  await new Promise((closed) => dialog.addEventListener('close', closed, { once: true }));
  const wanted = name.value.trim();
  if (dialog.returnValue === 'keep' && await command('person.keep', { name: wanted, subject }, 'person_failed')) {
    tell(text('person_kept', { name: wanted }));
  }
}

function openTokenDialog(): void {
  const dialog = element<HTMLDialogElement>('token-dialog');
  if (!dialog.open) {
    element<HTMLInputElement>('token').value = '';
    dialog.showModal();
  }
}
function closeTokenDialog(): void {
  element('token-wrong').hidden = true;
  element<HTMLDialogElement>('token-dialog').close();
}

function listen(): void {
  element('record').addEventListener('click', pressRecord);
  element('neutral').addEventListener('click', () => { void recordNeutral(); });
  watchOverflow();
  element('language').addEventListener('click', () => {
    const other = otherLanguage();
    memory.set('language', other);
    chooseLanguage(other);
    showAll();
  });
  element('fullscreen').addEventListener('click', () => {
    void (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen());
  });
  element('unlock').addEventListener('click', () => {
    if (!unlocked) {
      openTokenDialog();
      return;
    }
    unlocked = false;
    control.token = '';
    memory.set('token', '');
    control.reopen();
    showAll();
  });
  const dialog = element<HTMLDialogElement>('token-dialog');
  dialog.addEventListener('close', () => {
    const token = element<HTMLInputElement>('token').value.trim();
    if (dialog.returnValue === 'unlock' && token !== '') {
      element('token-wrong').hidden = true;
      void useToken(token);
    } else if (!unlocked) {
      recordWhenUnlocked = false;
    }
    dialog.returnValue = '';
  });
  document.addEventListener('keydown', (event) => {
    if (document.querySelector('dialog[open]') || event.ctrlKey || event.altKey || event.metaKey) {
      return;
    }
    if (event.key >= '1' && event.key <= String(kViews.length)) {
      chooseView(kViews[Number(event.key) - 1]);
    } else if (event.key === 'r' || event.key === 'R') {
      pressRecord();
    } else if (event.key === 'Escape' && countdown !== 0) {
      endCountdown();
    }
  });
}

const kLookAgain_ms = 3_000;
let begun = false; // whoever is here may look
let isPublic = false; // looking needs a token

/** Opens the connections where this browser may look; else asks for a token. */
async function begin(): Promise<void> {
  let may = await opens('');
  if (may === 'unknown') { // nobody answers, or is too busy to
    window.setTimeout(() => void begin(), kLookAgain_ms);
    return;
  }
  isPublic = may !== 'open';
  if (isPublic && control.token !== '') {
    const shown = await opens(control.token);
    may = shown === 'look' || shown === 'commands' ? shown : may;
  }
  if (may === 'nothing' || may === 'later') {
    control.token = '';
    memory.set('token', '');
    element('token-help').textContent = text('look_help');
    if (may === 'later') {
      element('token-wrong').textContent = text('token_later');
      element('token-wrong').hidden = false;
    }
    openTokenDialog();
    return;
  }
  if (may === 'look') {
    control.token = ''; // it opens no commands
  }
  begun = true;
  stream.open();
  control.open();
  if (isPublic) {
    watchToken();
  }
}

/** A token that was made anew opens nothing any more: whoever has the page open is asked for the new one. */
function watchToken(): void {
  const timer = window.setInterval(async () => {
    if (document.body.dataset.connection !== 'offline' || await opens('') !== 'nothing') {
      return;
    }
    window.clearInterval(timer);
    location.reload();
  }, kLookAgain_ms);
}

/** A token that was entered: for looking where that is not open yet, else for commands. */
async function useToken(token: string): Promise<void> {
  const may = isPublic ? await opens(token) : 'commands';
  if (may === 'nothing' || may === 'later' || may === 'unknown') {
    element('token-wrong').textContent = text(may === 'later' ? 'token_later' : 'token_wrong');
    element('token-wrong').hidden = false;
    openTokenDialog();
    return;
  }
  element('token-help').textContent = text('unlock_help');
  if (may === 'look' && begun) {
    tell(text('token_looks'));
    return;
  }
  control.token = may === 'commands' ? token : '';
  if (begun) {
    control.reopen();
  } else {
    await begin();
  }
}

function chooseView(name: View): void {
  view?.setView(name);
  memory.set('view', name);
  wantOfStream();
  showAll();
  showChosen(element('views'));
}

chooseLanguage(memory.get('language') || null);
try {
  view = new FaceView(element<HTMLCanvasElement>('face'), showAll);
} catch {
  view = null; // problem() says so
}
if (view) {
  studio = new Studio(view, control, {
    mayCommand: () => unlocked, command: (method, params) => command(method, params, 'studio_failed'), tell,
    trim: (take, length_s, from_s, to_s) => takeCare.openTrim(take, length_s, from_s, to_s) });
  view.knowledgeChanged = showAll;
  blend = new Blend(view, () => { wantOfStream(); showAll(); });
  keepFree(view);
}
for (const name of kViews) {
  const button = document.createElement('button');
  button.type = 'button';
  button.dataset.view = name;
  button.addEventListener('click', () => chooseView(name));
  element('views').append(button);
}
chooseView((kViews as string[]).includes(memory.get('view')) ? (memory.get('view') as View) : 'shaded');
listen();
expressions.setNames([]);
showAll();
void begin();
window.setInterval(() => {
  if (!looking && begun) {
    void look();
  }
}, kStatusPeriod_ms);
window.setInterval(() => { showState(); showFigures(); showRecording(); markOverflow(); }, 500);
