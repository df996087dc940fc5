// A cartoon head that ARKit's values move: what an avatar makes of them, roughly. Its shapes are made here, by formulas.
import * as THREE from 'three';
import { isSoftware } from './face_view';

/** ARKit's names, as the configuration and the control protocol write them. */
export const kArkitNames = [
  'eyeBlinkLeft', 'eyeLookDownLeft', 'eyeLookInLeft', 'eyeLookOutLeft', 'eyeLookUpLeft', 'eyeSquintLeft', 'eyeWideLeft',
  'eyeBlinkRight', 'eyeLookDownRight', 'eyeLookInRight', 'eyeLookOutRight', 'eyeLookUpRight', 'eyeSquintRight', 'eyeWideRight',
  'jawForward', 'jawLeft', 'jawRight', 'jawOpen', 'mouthClose', 'mouthFunnel', 'mouthPucker', 'mouthLeft', 'mouthRight',
  'mouthSmileLeft', 'mouthSmileRight', 'mouthFrownLeft', 'mouthFrownRight', 'mouthDimpleLeft', 'mouthDimpleRight',
  'mouthStretchLeft', 'mouthStretchRight', 'mouthRollLower', 'mouthRollUpper', 'mouthShrugLower', 'mouthShrugUpper',
  'mouthPressLeft', 'mouthPressRight', 'mouthLowerDownLeft', 'mouthLowerDownRight', 'mouthUpperUpLeft', 'mouthUpperUpRight',
  'browDownLeft', 'browDownRight', 'browInnerUp', 'browOuterUpLeft', 'browOuterUpRight', 'cheekPuff', 'cheekSquintLeft',
  'cheekSquintRight', 'noseSneerLeft', 'noseSneerRight', 'tongueOut'];

/** Values by name; what is not there is 0. */
export type Values = Record<string, number>;

// Lengths in half widths of the head; x to the person's left, which is the viewer's right, y up, z out of the face.
const kHead = { x: 0.94, y: 1.16, z: 0.95 };
const kMouth = { y: -0.53, half: 0.34 };
const kEye = { x: 0.37, y: 0.13, radius: 0.235 };
const kColours = {
  skin: 0xe8a98a, lid: 0xd99678, lip: 0xb9545a, mouth: 0x3d1218, teeth: 0xf6f2ea, tongue: 0xcc6a70, hair: 0x3a2a24, iris: 0x2f7f86,
  white: 0xfbfaf7, black: 0x120d0c, coat: 0x2f6f78 };
/** Along a lip or a brow, and around it. */
const kAlong = 32;
const kAround = 10;

/** Without a GPU: so much of the screen's pixels along each side, and so long between two pictures. */
const kSoftwarePixels = 0.7;
const kSoftwarePause_ms = 80;

const mix = (a: number, b: number, part: number) => a + (b - a) * part;
const smooth = (from: number, to: number, at: number) => {
  const part = Math.min(1, Math.max(0, (at - from) / (to - from)));
  return part * part * (3 - 2 * part);
};
const bump = (x: number, y: number, atX: number, atY: number, width: number) =>
  Math.exp(-((x - atX) ** 2 + (y - atY) ** 2) / (width * width));

/** How much narrower the head is towards the chin; y from -1 to 1. */
const taper = (y: number) => (y < 0 ? 1 - 0.3 * Math.pow(-y, 1.7) : 1 - 0.05 * y * y);

/** Where the front of the head at rest is. */
export function frontOf(x: number, y: number): number {
  const up = Math.min(0.98, Math.max(-0.98, y / kHead.y));
  const aside = x / (kHead.x * taper(up));
  return kHead.z * Math.sqrt(Math.max(0.02, 1 - up * up - aside * aside));
}

/** A tube or a ribbon along x whose points are set anew with every face. */
class Strand {
  readonly mesh: THREE.Mesh;
  private readonly at: THREE.BufferAttribute;

  /** rings: points around each of the kAlong + 1 places; 2: a flat ribbon. */
  constructor(colour: number, private readonly rings: number) {
    const geometry = new THREE.BufferGeometry();
    this.at = new THREE.BufferAttribute(new Float32Array(3 * (kAlong + 1) * rings), 3).setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute('position', this.at);
    const triangles: number[] = [];
    const sides = rings === 2 ? 1 : rings;
    for (let i = 0; i < kAlong; ++i) {
      for (let j = 0; j < sides; ++j) {
        const [a, b] = [i * rings + j, i * rings + ((j + 1) % rings)];
        triangles.push(a, a + rings, b, b, a + rings, b + rings);
      }
    }
    geometry.setIndex(triangles);
    const material = rings === 2 ? new THREE.MeshBasicMaterial({ color: colour, side: THREE.DoubleSide })
      : new THREE.MeshStandardMaterial({ color: colour, roughness: 0.55, side: THREE.DoubleSide });
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.frustumCulled = false;
  }

  /** part: 0 at the person's right end, 1 at the left one. */
  tube(centre: (part: number) => [number, number, number], radius: (part: number) => number): void {
    for (let i = 0; i <= kAlong; ++i) {
      const part = i / kAlong;
      const [x, y, z] = centre(part);
      const r = radius(part);
      for (let j = 0; j < this.rings; ++j) {
        const turn = (2 * Math.PI * j) / this.rings;
        this.at.setXYZ(i * this.rings + j, x, y + r * Math.sin(turn), z + r * Math.cos(turn));
      }
    }
    this.changed();
  }

  ribbon(upper: (part: number) => [number, number, number], lower: (part: number) => [number, number, number]): void {
    for (let i = 0; i <= kAlong; ++i) {
      this.at.setXYZ(2 * i, ...upper(i / kAlong));
      this.at.setXYZ(2 * i + 1, ...lower(i / kAlong));
    }
    this.changed();
  }

  private changed(): void {
    this.at.needsUpdate = true;
    if (this.rings > 2) {
      this.mesh.geometry.computeVertexNormals();
    }
  }
}

/** One eye with its lids. */
class Eye {
  readonly group = new THREE.Group();
  private readonly ball = new THREE.Group();
  private readonly upper = new THREE.Group();
  private readonly lower = new THREE.Group();

  /** side: 1 for the person's left. */
  constructor(private readonly side: 1 | -1) {
    const { radius } = kEye;
    this.group.position.set(side * kEye.x, kEye.y, frontOf(kEye.x, kEye.y) - 0.11);
    this.group.rotation.y = side * 0.16;
    const solid = (colour: number, roughness: number) => new THREE.MeshStandardMaterial({ color: colour, roughness, side: THREE.DoubleSide });
    const cap = (scale: number, colour: number, angle: number, roughness: number) => {
      const mesh = new THREE.Mesh(new THREE.SphereGeometry(radius * scale, 40, 20, 0, 2 * Math.PI, 0, angle), solid(colour, roughness));
      mesh.rotation.x = Math.PI / 2; // its pole looks ahead
      return mesh;
    };
    this.ball.add(cap(1, kColours.white, Math.PI, 0.25), cap(1.008, kColours.iris, 0.52, 0.3), cap(1.014, kColours.black, 0.27, 0.2));
    const glint = new THREE.Mesh(new THREE.SphereGeometry(0.022, 12, 8), new THREE.MeshBasicMaterial({ color: 0xffffff }));
    glint.position.set(-0.06, 0.07, 0.97 * radius);
    const lid = (from: number, colour: number) => new THREE.Mesh(
      new THREE.SphereGeometry(radius * 1.07, 40, 20, 0, 2 * Math.PI, from, Math.PI / 2), solid(colour, 0.6));
    const lash = (thick: number) => {
      const arc = new THREE.Mesh(new THREE.TorusGeometry(radius * 1.08, thick, 8, 40, Math.PI), solid(kColours.hair, 0.8));
      arc.rotation.x = Math.PI / 2; // the front half of the rim
      return arc;
    };
    this.upper.add(lid(0, kColours.lid), lash(0.02));
    this.lower.add(lid(Math.PI / 2, kColours.skin), lash(0.007));
    this.group.add(this.ball, glint, this.upper, this.lower);
  }

  show(of: (name: string) => number): void {
    const name = this.side > 0 ? 'Left' : 'Right';
    const own = (base: string) => of(base + name);
    // Inwards is to the person's right for the left eye.
    const outwards = own('eyeLookOut') - own('eyeLookIn');
    const downwards = own('eyeLookDown') - own('eyeLookUp');
    this.ball.rotation.set(0.5 * downwards, 0.6 * this.side * outwards, 0);
    const closed = Math.min(1, own('eyeBlink'));
    const squint = own('eyeSquint');
    this.upper.rotation.x = mix(-0.62 - 0.3 * own('eyeWide') + 0.22 * squint + 0.3 * downwards, 0.36, closed);
    this.lower.rotation.x = mix(0.72 + 0.12 * own('eyeWide') - 0.38 * squint - 0.2 * own('cheekSquint') + 0.1 * downwards, 0.36, closed);
  }
}

export class Puppet {
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera(24, 1, 0.1, 50);
  private readonly head = new THREE.Group();
  private readonly eyes = [new Eye(1), new Eye(-1)];
  private readonly skin: THREE.Mesh;
  /** [vertex] of the skin at rest. */
  private readonly rest: Float32Array;
  private readonly brows = [new Strand(kColours.hair, kAround), new Strand(kColours.hair, kAround)];
  private readonly lips = { upper: new Strand(kColours.lip, kAround), lower: new Strand(kColours.lip, kAround) };
  private readonly inside = { cavity: new Strand(kColours.mouth, 2), teeth: new Strand(kColours.teeth, 2), tongue: new Strand(kColours.tongue, 2) };
  private readonly nose = new THREE.Group();
  private values: Values = {};
  private pending = false;
  private readonly software: boolean;
  private drawn_ms = -Infinity;
  /** Pictures drawn since the start. */
  drawn = 0;

  /** Throws where there is no WebGL 2. */
  constructor(private readonly canvas: HTMLCanvasElement) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.software = isSoftware(this.renderer);
    const skin = new THREE.MeshStandardMaterial({ color: kColours.skin, roughness: 0.62 });
    const geometry = new THREE.SphereGeometry(1, 72, 60);
    const at = geometry.getAttribute('position') as THREE.BufferAttribute;
    for (let i = 0; i < at.count; ++i) {
      const [x, y, z] = [at.getX(i), at.getY(i), at.getZ(i)];
      at.setXYZ(i, kHead.x * taper(y) * x, kHead.y * y, kHead.z * (z > 0 ? 1 : 0.98) * z);
    }
    geometry.computeVertexNormals();
    this.rest = Float32Array.from(at.array);
    this.skin = new THREE.Mesh(geometry, skin);
    this.head.add(this.skin, ...this.eyes.map((eye) => eye.group), ...this.brows.map((brow) => brow.mesh));
    this.head.add(...Object.values(this.inside).map((part) => part.mesh), this.lips.upper.mesh, this.lips.lower.mesh);
    this.addNose(skin);
    this.addHair();
    for (const side of [1, -1]) {
      const ear = new THREE.Mesh(new THREE.SphereGeometry(0.2, 24, 16), skin);
      ear.scale.set(0.5, 1.05, 0.75);
      ear.position.set(side * 0.95, -0.02, -0.08);
      this.head.add(ear);
    }
    this.scene.add(this.head, ...this.body(skin), ...this.lights());
    new ResizeObserver(() => this.request()).observe(canvas);
    this.show({}, null);
  }

  private addNose(skin: THREE.Material): void {
    const ball = (x: number, y: number, z: number, radius: number) => {
      const mesh = new THREE.Mesh(new THREE.SphereGeometry(radius, 24, 16), skin);
      mesh.position.set(x, y, z);
      return mesh;
    };
    const tip = ball(0, -0.2, frontOf(0, -0.2) + 0.05, 0.12);
    tip.scale.set(1, 0.92, 0.95);
    const bridge = ball(0, 0.0, frontOf(0, 0) - 0.075, 0.13);
    bridge.scale.set(1.05, 2.3, 0.85);
    this.nose.add(tip, bridge, ball(0.1, -0.23, frontOf(0.1, -0.23) + 0.0, 0.075), ball(-0.1, -0.23, frontOf(0.1, -0.23) + 0.0, 0.075));
    this.head.add(this.nose);
  }

  private addHair(): void {
    const material = new THREE.MeshStandardMaterial({ color: kColours.hair, roughness: 0.85, side: THREE.DoubleSide });
    const cap = new THREE.Mesh(new THREE.SphereGeometry(1, 48, 24, 0, 2 * Math.PI, 0, 1.42), material);
    cap.scale.set(kHead.x * 1.06, kHead.y * 1.05, kHead.z * 1.08);
    cap.rotation.x = -0.62;
    this.head.add(cap);
    // A quiff over the forehead.
    for (const [x, y, size] of [[-0.34, 0.84, 0.26], [-0.08, 0.92, 0.3], [0.22, 0.9, 0.29], [0.46, 0.8, 0.22]]) {
      const curl = new THREE.Mesh(new THREE.SphereGeometry(size, 20, 14), material);
      curl.position.set(x, y, frontOf(x, y) - 0.02);
      curl.scale.set(1.25, 0.62, 0.8);
      curl.rotation.z = -0.5 * x - 0.15;
      this.head.add(curl);
    }
  }

  /** What does not turn with the head. */
  private body(skin: THREE.Material): THREE.Object3D[] {
    const neck = new THREE.Mesh(new THREE.CylinderGeometry(0.36, 0.42, 0.9, 32), skin);
    neck.position.set(0, -1.3, -0.12);
    const coat = new THREE.Mesh(new THREE.SphereGeometry(1, 48, 24), new THREE.MeshStandardMaterial({ color: kColours.coat, roughness: 0.9 }));
    coat.scale.set(1.35, 0.72, 0.72);
    coat.position.set(0, -2.2, -0.2);
    return [neck, coat];
  }

  private lights(): THREE.Object3D[] {
    const light = (colour: number, strength: number, x: number, y: number, z: number) => {
      const lamp = new THREE.DirectionalLight(colour, strength);
      lamp.position.set(x, y, z);
      return lamp;
    };
    return [new THREE.HemisphereLight(0xdfe9f5, 0x5a4038, 1.15), light(0xfff2e2, 2.1, -1.6, 2, 2.4), light(0x9ec4ff, 0.7, 2.4, 0.4, 1),
            light(0x8fe0d2, 1.3, 1.4, 1.2, -2)];
  }

  /** Of ARKit's values, 0 to 1; camera_from_head: rows of rotation and translation, as frames have it; null: straight ahead. */
  show(values: Values, camera_from_head: ArrayLike<number> | null): void {
    this.values = values;
    const turned = new THREE.Matrix4();
    if (camera_from_head) {
      const r = camera_from_head;
      // The camera's axes, y down and z forward, turned upright.
      turned.set(r[0], r[1], r[2], 0, -r[4], -r[5], -r[6], 0, -r[8], -r[9], -r[10], 0, 0, 0, 0, 1);
    }
    this.head.quaternion.setFromRotationMatrix(turned);
    this.shape();
    this.request();
  }

  private shape(): void {
    const of = (name: string) => this.values[name] ?? 0;
    this.eyes.forEach((eye) => eye.show(of));
    this.shapeSkin(of);
    this.shapeMouth(of);
    for (const [i, name] of ['Left', 'Right'].entries()) {
      const side = i === 0 ? 1 : -1;
      const [down, inner, outer] = [of(`browDown${name}`), of('browInnerUp'), of(`browOuterUp${name}`)];
      this.brows[i].tube((part) => {
        const out = side > 0 ? part : 1 - part; // 0 at the nose
        const x = side * mix(0.17 - 0.04 * down, 0.62, out);
        const y = 0.44 + 0.09 * Math.sin(Math.PI * Math.min(1, out * 0.85 + 0.1)) + 0.16 * inner * (1 - out) ** 1.5 + 0.17 * outer * smooth(0.2, 0.9, out)
          - down * mix(0.17, 0.06, out);
        return [x, y, frontOf(x, y) + 0.02];
      }, (part) => 0.05 * Math.pow(Math.sin(Math.PI * mix(0, 1, Math.pow(side > 0 ? part : 1 - part, 0.75))), 0.5));
    }
    const sneer = (of('noseSneerLeft') + of('noseSneerRight')) / 2;
    this.nose.position.y = 0.035 * sneer;
    this.nose.scale.set(1 + 0.12 * sneer, 1 - 0.08 * sneer, 1);
  }

  private shapeSkin(of: (name: string) => number): void {
    const at = this.skin.geometry.getAttribute('position') as THREE.BufferAttribute;
    const drop = 0.24 * of('jawOpen');
    const aside = 0.1 * (of('jawLeft') - of('jawRight'));
    for (let i = 0; i < at.count; ++i) {
      let [x, y, z] = [this.rest[3 * i], this.rest[3 * i + 1], this.rest[3 * i + 2]];
      const jaw = smooth(-0.42, -0.85, y) * smooth(-0.5, 0.2, z);
      const front = smooth(0.1, 0.5, z);
      const swell = front * (0.13 * of('cheekPuff') * (bump(x, y, 0.52, -0.42, 0.3) + bump(x, y, -0.52, -0.42, 0.3))
        + 0.07 * of('cheekSquintLeft') * bump(x, y, 0.5, -0.16, 0.22) + 0.07 * of('cheekSquintRight') * bump(x, y, -0.5, -0.16, 0.22)
        + 0.05 * of('mouthSmileLeft') * bump(x, y, 0.52, -0.28, 0.22) + 0.05 * of('mouthSmileRight') * bump(x, y, -0.52, -0.28, 0.22));
      x += aside * jaw + 0.7 * swell * Math.sign(x);
      y -= drop * jaw;
      z += 0.1 * of('jawForward') * jaw + swell;
      at.setXYZ(i, x, y, z);
    }
    at.needsUpdate = true;
    this.skin.geometry.computeVertexNormals();
  }

  private shapeMouth(of: (name: string) => number): void {
    const both = (base: string) => (of(`${base}Left`) + of(`${base}Right`)) / 2;
    const [jaw, funnel, pucker] = [of('jawOpen'), of('mouthFunnel'), of('mouthPucker')];
    const open = Math.max(0, jaw - of('mouthClose'));
    const round = Math.max(funnel, pucker);
    const shift = 0.13 * (of('mouthLeft') - of('mouthRight')) + 0.06 * (of('jawLeft') - of('jawRight'));
    const corner = (side: 1 | -1) => {
      const own = (base: string) => of(base + (side > 0 ? 'Left' : 'Right'));
      const half = kMouth.half * (1 - 0.5 * pucker - 0.3 * funnel) + 0.1 * own('mouthSmile') + 0.08 * own('mouthStretch') + 0.04 * own('mouthDimple') - 0.05 * open;
      return { x: side * half + shift,
               y: kMouth.y + 0.15 * own('mouthSmile') + 0.02 * own('mouthDimple') - 0.13 * own('mouthFrown') - 0.05 * own('mouthStretch') - 0.08 * jaw };
    };
    const [right, left] = [corner(-1), corner(1)];
    const arch = (part: number) => Math.pow(Math.sin(Math.PI * part), 0.75);
    const sided = (part: number, base: string) => mix(of(`${base}Right`), of(`${base}Left`), part);
    // Where the lips part, of the upper and of the lower one, below the line between the corners.
    const line = (part: number) => mix(right.y, left.y, part) - 0.06 * both('mouthSmile') * arch(part) + 0.05 * both('mouthFrown') * arch(part);
    const upperEdge = (part: number) => line(part) + arch(part) * (0.05 * round * open + 0.04 * of('mouthShrugUpper') + 0.1 * sided(part, 'mouthUpperUp')
      + 0.045 * funnel);
    const lowerEdge = (part: number) => line(part) - arch(part) * (0.36 * open + 0.1 * sided(part, 'mouthLowerDown') + 0.045 * funnel) + 0.05 * of('mouthShrugLower') * arch(part);
    const lower = (part: number) => Math.min(lowerEdge(part), upperEdge(part));
    const x = (part: number) => mix(right.x, left.x, part);
    const pout = (part: number) => arch(part) * (0.1 * pucker + 0.08 * funnel);
    const place = (part: number, y: number, ahead: number): [number, number, number] =>
      [x(part), y, frontOf(x(part), Math.max(y, -0.72)) + ahead + pout(part) * 0.6];
    const press = both('mouthPress');
    const thick = (part: number, size: number, roll: number) =>
      size * (0.32 + 0.68 * arch(part)) * (1 - 0.75 * roll) * (1 - 0.35 * press) * (1 + 0.25 * pucker);
    const above = (part: number) => thick(part, 0.05, of('mouthRollUpper'));
    const below = (part: number) => thick(part, 0.058, of('mouthRollLower'));
    this.lips.upper.tube((part) => place(part, upperEdge(part) + above(part) * 0.75, 0.015 + pout(part) * 0.4), above);
    this.lips.lower.tube((part) => place(part, lower(part) - below(part) * 0.75, 0.015 + pout(part) * 0.4 + 0.06 * of('jawForward')), below);
    // Between the lips: share 0 at the upper edge, 1 at the lower one.
    const within = (part: number, share: number, ahead: number): [number, number, number] => {
      const [over, under] = [place(part, upperEdge(part) + 0.01, ahead), place(part, lower(part) - 0.01, ahead)];
      return [over[0], mix(over[1], under[1], share), mix(over[2], under[2], share)];
    };
    const gap = (part: number) => Math.max(0.001, upperEdge(part) - lower(part));
    this.inside.cavity.ribbon((part) => within(part, 0, 0.035), (part) => within(part, 1, 0.035));
    this.inside.teeth.ribbon((part) => within(part, 0, 0.045), (part) => within(part, Math.min(0.65, 0.09 / gap(part)), 0.045));
    const tongue = 0.45 + 0.5 * of('tongueOut');
    this.inside.tongue.ribbon((part) => within(part, 1 - tongue * Math.max(0, Math.sin(Math.PI * part) - 0.2), 0.04), (part) => within(part, 1, 0.04));
    this.inside.teeth.mesh.visible = this.inside.tongue.mesh.visible = gap(0.5) > 0.02;
  }

  /** Draws with one of the browser's next pictures; a processor that draws has others to serve. */
  private request(): void {
    if (!this.pending) {
      this.pending = true;
      const wait_ms = (this.software ? kSoftwarePause_ms : 0) - (performance.now() - this.drawn_ms);
      window.setTimeout(() => requestAnimationFrame(() => this.draw()), Math.max(0, wait_ms));
    }
  }

  private draw(): void {
    this.pending = false;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (width === 0 || height === 0) {
      return;
    }
    this.drawn_ms = performance.now();
    this.renderer.setPixelRatio(this.software ? kSoftwarePixels : Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // The head with room for its turns, in whatever form the canvas has.
    const [halfHeight, halfWidth] = [1.62, 1.3];
    const slope = Math.tan((this.camera.fov * Math.PI) / 360);
    this.camera.position.set(0, -0.1, Math.max(halfHeight, halfWidth / this.camera.aspect) / slope);
    this.camera.lookAt(0, -0.1, 0);
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
    this.canvas.dataset.drawn = String(++this.drawn);
  }
}
