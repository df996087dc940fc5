// How much of the face is drawn: pixels, triangles, pictures a second.

/** mostTriangles: of the levels that have no more, the finest is drawn; the coarsest where none has. */
export interface Detail {
  pixelRatio: number;
  mostTriangles: number;
  mostRate: number;
}
export const kDetails: Detail[] = [
  { pixelRatio: 2, mostTriangles: Infinity, mostRate: 120 },
  { pixelRatio: 1, mostTriangles: Infinity, mostRate: 120 },
  { pixelRatio: 1, mostTriangles: 70_000, mostRate: 60 },
  { pixelRatio: 0.75, mostTriangles: 35_000, mostRate: 30 },
  { pixelRatio: 0.5, mostTriangles: 0, mostRate: 15 },
];
/** Where a machine without a GPU starts, and the most that it gets. */
const kSoftwareStart = 3;
const kSoftwareMost = 1;
/** A picture that takes longer is too slow, one that takes less is fast enough for more detail, ms. */
const kSlow_ms = 30;
const kFast_ms = 9;
const kSlowPictures = 3;
const kSlowPicturesOfSoftware = 12;
const kFastPictures = 400;
/** Who had to give up detail so often stays where it is. */
const kMostFalls = 3;

/** The level to draw, an index. triangles: of each level, coarse to fine. */
export function levelFor(triangles: number[], most: number): number {
  let level = 0;
  while (level + 1 < triangles.length && triangles[level + 1] <= most) {
    ++level;
  }
  return level;
}

/** Lowers the detail soon where pictures take too long, raises it late, and not for ever to and fro. */
export class DetailChooser {
  step: number;
  private slow = 0;
  private fast = 0;
  private falls = 0;

  /** software: drawn by the processor. */
  constructor(private readonly software: boolean) {
    this.step = software ? kSoftwareStart : 0;
  }

  get detail(): Detail {
    return kDetails[this.step];
  }

  /** What a picture took. true: the detail changed. */
  judge(took_ms: number): boolean {
    this.slow = took_ms > kSlow_ms ? this.slow + 1 : Math.max(0, this.slow - 1);
    this.fast = took_ms < kFast_ms ? this.fast + 1 : 0;
    const tooSlow = this.slow >= (this.software ? kSlowPicturesOfSoftware : kSlowPictures);
    if (tooSlow && this.step + 1 < kDetails.length) {
      ++this.falls;
      return this.change(this.step + 1);
    }
    const most = this.software ? kSoftwareMost : 0;
    if (this.fast >= kFastPictures && this.step > most && this.falls < kMostFalls) {
      return this.change(this.step - 1);
    }
    return false;
  }

  private change(step: number): true {
    this.step = step;
    this.slow = this.fast = 0;
    return true;
  }
}

/** Each edge once, as pairs of vertices. */
export function edgesOf(triangles: Uint32Array): Uint32Array {
  const edges = new Set<number>();
  for (let i = 0; i < triangles.length; i += 3) {
    for (let corner = 0; corner < 3; ++corner) {
      const [a, b] = [triangles[i + corner], triangles[i + ((corner + 1) % 3)]];
      edges.add(Math.min(a, b) * 2 ** 26 + Math.max(a, b));
    }
  }
  const pairs = new Uint32Array(2 * edges.size);
  let count = 0;
  for (const edge of edges) {
    pairs[count++] = Math.floor(edge / 2 ** 26);
    pairs[count++] = edge % 2 ** 26;
  }
  return pairs;
}
