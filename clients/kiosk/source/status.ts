// What /control says, as far as the page reads it (docs/control-protocol.md).
export interface DeviceStatus {
  state: string;
  reason: string;
}
export interface NamedDevice extends DeviceStatus {
  name: string;
}
/** How two cameras stand to each other, against their calibration. */
export interface CameraPair {
  left: string;
  right: string;
  matches: number;
  median_px: number;
  problem: string;
  columns: number;
  /** Over the left camera's picture, row by row; below 0: nothing was seen there. */
  error_px: number[];
}
export interface Recording {
  state: string;
  reason: string;
  warning: string;
  file: string;
  frames: number;
  dropped: number;
  bytes: number;
}
export interface PoseControl {
  vertex: number;
  at_mm?: [number, number, number];
  at_px?: [number, number];
  met: boolean;
  problem: string;
}
export interface StudioStatus {
  state: string;
  take: string;
  reason: string;
  done: number;
  total: number;
  posing: boolean;
  shown: 'pose' | 'take' | 'keys';
  time_s: number;
  duration_s: number;
  events: number;
  solved: number;
  superseded: number;
  latency_ms: { mean: number; p95: number };
  controls: PoseControl[];
  places: Record<string, number>;
  warnings: string[];
  exported: string;
}
export interface Key {
  time_s: number;
  frame?: number;
  controls?: { vertex: number | string; at_mm?: number[]; move_mm?: number[]; at_px?: number[] }[];
}
export interface Keys {
  keys: Key[];
  beyond?: boolean;
}
/** What the head before a live camera has shown of its own shape. */
export interface Learning {
  state: 'looking' | 'solving' | 'learned';
  subject: number;
  note: string;
  seen_deg: [number, number][];
  turned_left_deg: number;
  turned_right_deg: number;
  needed_deg: number;
}
/** Where expression and head go, in another protocol. */
export interface BridgeTarget {
  protocol: string;
  target: string;
  /** Of a VRChat that answers; else "". */
  name?: string;
  frames: number;
  failed: number;
  reason: string;
}
/** How far an avatar follows a value. */
export interface Tuning {
  gain: number;
  dead_zone: number;
  smoothing_ms: number;
}
export interface Bridges {
  targets: BridgeTarget[];
  /** By ARKit's name, or "all": what is not sent as it comes. */
  values?: Record<string, Tuning>;
  neutral: { state: 'none' | 'recording' | 'set' | 'failed'; reason: string; frames: number };
}
export interface Status {
  version: string;
  state: string;
  mode: string;
  reason: string;
  source: { name: string; width_px: number; height_px: number } | null;
  camera: DeviceStatus | null;
  rig: { cameras: NamedDevice[]; pairs?: CameraPair[]; trigger: DeviceStatus | null } | null;
  tracking: string;
  degraded_reason: string;
  given_up: string;
  frames: { processed: number; face: number; mesh: number };
  frames_per_second: number;
  gpu: string;
  studio: StudioStatus | null;
  stream: { readers: { frames_dropped: number }[] };
  recording: Recording | null;
  learning: Learning | null;
  bridges: Bridges | null;
  takes: { list: number; trim?: TrimStatus | null };
}
/** The trim that is in work, or was the last. */
export interface TrimStatus {
  take: string;
  to: string;
  done: number;
  total: number;
  state: 'working' | 'done' | 'failed' | 'broken off';
  reason: string;
}
export interface Take {
  name: string;
  created_utc?: string;
  frames?: number;
  duration_s?: number;
  bytes?: number;
  picture_bytes?: number;
  sound_bytes?: number;
  mesh_frames?: number;
  thumbnail?: number;
  closed?: boolean;
  note?: string;
  slate?: { scene: string; take: string };
  cut_from?: string;
  error?: string;
}
export interface Takes {
  folder: string;
  count: number;
  takes: Take[];
}

/** The last part of a path, without its ending. */
export function baseName(path: string): string {
  return path.replace(/^.*\//, '').replace(/\.[^.]*$/, '');
}
