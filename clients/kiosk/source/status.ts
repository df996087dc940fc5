// What /control says, as far as the page reads it (docs/control-protocol.md).
export interface DeviceStatus {
  state: string;
  reason: string;
}
export interface NamedDevice extends DeviceStatus {
  name: string;
}
export interface Recording {
  state: string;
  reason: string;
  file: string;
  frames: number;
  bytes: number;
}
export interface Status {
  version: string;
  state: string;
  reason: string;
  source: { name: string; width_px: number; height_px: number } | null;
  camera: DeviceStatus | null;
  rig: { cameras: NamedDevice[]; trigger: DeviceStatus | null } | null;
  tracking: string;
  degraded_reason: string;
  frames: { processed: number; face: number; mesh: number };
  frames_per_second: number;
  gpu: string;
  stream: { readers: { frames_dropped: number }[] };
  recording: Recording | null;
}
export interface Take {
  name: string;
  created_utc?: string;
  frames?: number;
  duration_s?: number;
  bytes?: number;
  closed?: boolean;
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
