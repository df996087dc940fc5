// The face in the middle of the page: the newest frame's mesh, drawn by three.js. Draws only what is new, and less of it where
// the machine is too slow.
import * as THREE from 'three';
import { DetailChooser, edgesOf, levelFor, type Detail } from './levels';

export type View = 'shaded' | 'normals' | 'albedo' | 'wire' | 'confidence' | 'relief';
export const kViews: View[] = ['shaded', 'normals', 'albedo', 'wire', 'confidence', 'relief'];
/** What the relief's strongest colours stand for. */
export const kRelief_mm = 0.3;

/** One frame's mesh as it came, arrays not copied. Positions: head frame, integer * stepMm. */
export interface FaceMesh {
  vertices: Int16Array;
  normals: Int16Array;
  stepMm: number;
  /** [vertex] 255 is 1; null where the mesh was not refined. */
  confidence: Uint8Array | null;
  /** The mesh without displacements, its normals, and the displacements along them, mm; null: not known. */
  coarse: Int16Array | null;
  coarseNormals: Int16Array | null;
  relief: Float32Array | null;
  /** Rows of camera_from_head: rotation and translation, mm; x right, y down, z forward. */
  pose: ArrayLike<number>;
}

/** The camera that sees the face: its picture's pixels, and whether people see it mirrored. */
export interface Lens {
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  width: number;
  height: number;
  mirrored: boolean;
}

// refined: 0 is the coarse mesh, 1 the refined one. Normals in the camera's axes do not turn with the hand.
const vertexShader = `
in vec3 position; in vec3 normal; in vec3 coarse; in vec3 coarse_normal; in vec3 color; in vec3 region; in float confidence; in float relief;
uniform mat4 modelMatrix; uniform mat4 modelViewMatrix; uniform mat4 projectionMatrix;
uniform float step_mm; uniform float albedo_scale; uniform float refined;
out vec3 v_normal; out vec3 v_camera_normal; out vec3 v_position; out vec3 v_albedo; out vec3 v_region; out float v_confidence; out float v_relief;
void main() {
  v_region = region;
  v_confidence = confidence;
  v_relief = relief * refined;
  vec3 at = mix(coarse, position, refined);
  vec3 out_of = mix(coarse_normal, normal, refined);
  vec4 seen = modelViewMatrix * vec4(at * step_mm, 1.0);
  v_position = seen.xyz;
  v_camera_normal = mat3(modelMatrix) * out_of;
  v_normal = mat3(modelViewMatrix) * out_of;
  v_albedo = color * albedo_scale;
  gl_Position = projectionMatrix * seen;
}`;

// Three lights that stand still before the face; wrapped, for skin lets light pass round an edge, red more than blue.
const fragmentShader = `
precision highp float;
in vec3 v_normal; in vec3 v_camera_normal; in vec3 v_position; in vec3 v_albedo; in vec3 v_region; in float v_confidence; in float v_relief;
uniform int view; uniform vec3 clay; uniform bool has_albedo; uniform bool has_confidence; uniform bool has_regions; uniform bool has_relief; uniform float relief_mm;
const vec3 kUnknown = vec3(0.24);
out vec4 colour;
vec3 lit(vec3 n, vec3 toward, vec3 light, vec3 wrap) {
  return light * max((vec3(dot(n, toward)) + wrap) / (1.0 + wrap), 0.0);
}
float glint(vec3 n, vec3 toward, vec3 eye, float power) {
  return pow(max(dot(n, normalize(toward + eye)), 0.0), power);
}
vec3 srgb(vec3 linear) {
  vec3 c = clamp(linear, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}
void main() {
  vec3 n = normalize(v_normal);
  vec3 eye = normalize(-v_position);
  if (dot(n, eye) < 0.0) n = -n;
  vec3 albedo = has_albedo ? v_albedo : clay;
  if (view == 1) { colour = vec4(0.5 + 0.5 * normalize(v_camera_normal), 1.0); return; }
  if (view == 2 && has_albedo) { colour = vec4(srgb(albedo), 1.0); return; }
  if (view == 2) { albedo = kUnknown; }
  if (view == 3) { albedo = vec3(0.035, 0.045, 0.06); }
  if (view == 4) {
    vec3 upper = mix(vec3(0.75, 0.55, 0.10), vec3(0.10, 0.50, 0.42), smoothstep(0.5, 1.0, v_confidence));
    vec3 known = mix(vec3(0.75, 0.10, 0.05), upper, smoothstep(0.0, 0.5, v_confidence));
    albedo = has_confidence ? mix(kUnknown, known, smoothstep(0.0, 0.02, v_confidence)) : kUnknown;
  }
  if (view == 5) {
    float part = clamp(v_relief / relief_mm, -1.0, 1.0);
    vec3 most = part < 0.0 ? vec3(0.06, 0.22, 0.75) : vec3(0.75, 0.20, 0.05);
    albedo = has_relief ? mix(vec3(0.48), most, abs(part)) : kUnknown;
  }
  // Soft colours: the skin keeps its light and shade.
  if (has_regions && view == 0) { albedo = mix(albedo, v_region * v_region * (0.25 + dot(albedo, vec3(0.5))), 0.7); }
  vec3 key = normalize(vec3(-0.55, 0.65, 0.75)), fill = normalize(vec3(0.85, 0.05, 0.55)), rim = normalize(vec3(0.5, 0.5, -0.8));
  vec3 wrap = view == 3 ? vec3(0.1) : vec3(0.32, 0.18, 0.12);
  vec3 light = vec3(0.10, 0.115, 0.14) * (0.65 + 0.35 * n.y) + lit(n, key, vec3(1.45, 1.36, 1.25), wrap) + lit(n, fill, vec3(0.30, 0.36, 0.46), wrap);
  float edge = pow(1.0 - max(dot(n, eye), 0.0), 3.0);
  vec3 shine = vec3(0.055) * glint(n, key, eye, 28.0) + vec3(0.035) * glint(n, fill, eye, 16.0) + vec3(0.30, 0.38, 0.48) * edge * (0.25 + 0.75 * max(dot(n, rim), 0.0)) * 0.45;
  vec3 c = albedo * light + shine;
  colour = vec4(srgb(c / (1.0 + 0.18 * c)), 1.0);
}`;

const lineShader = `
precision highp float;
in vec3 v_normal; in vec3 v_position;
out vec4 colour;
void main() {
  float facing = abs(dot(normalize(v_normal), normalize(-v_position)));
  colour = vec4(mix(vec3(0.10, 0.30, 0.36), vec3(0.42, 0.86, 0.80), facing), 0.25 + 0.6 * facing);
}`;

/** A pointer that moves less has pressed, not turned, px. */
const kPress_px = 6;
/** The face takes no less than this part of the stage's height, whatever covers the rest. */
const kLeastFree = 0.25;
/** Of the way to where the face should stand it goes so much with each picture. */
const kPace = 0.35;

/** Whether the processor draws. */
export function isSoftware(renderer: THREE.WebGLRenderer): boolean {
  const gl = renderer.getContext();
  const names = gl.getExtension('WEBGL_debug_renderer_info');
  const device = String(gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  return /swiftshader|llvmpipe|softpipe|software/i.test(device);
}

export class FaceView {
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera(24, 1, 10, 10000);
  private readonly head = new THREE.Group();
  private readonly uniforms = {
    step_mm: { value: 0.002 }, albedo_scale: { value: 1 }, view: { value: 0 },
    has_albedo: { value: false }, has_confidence: { value: false }, has_regions: { value: false },
    has_relief: { value: false }, relief_mm: { value: kRelief_mm }, refined: { value: 1 },
    clay: { value: new THREE.Color().setRGB(0.50, 0.325, 0.255, THREE.LinearSRGBColorSpace) },
  };
  private readonly surface: THREE.Mesh;
  private readonly wire: THREE.LineSegments;
  private levels: Uint32Array[] = [];
  private vertexCount = 0;
  private drawnLevel = -1;
  private edgesDrawn = false;
  /** Of each vertex a zero. */
  private nothing = new Uint8Array();
  private readonly centre = new THREE.Vector3();
  private radius = 120;
  private placed = false;
  private turn = { yaw: 0, pitch: 0, zoom: 1 };
  private pending = false;
  private lastDrawn_ms = 0;
  private readonly chooser: DetailChooser;
  /** What covers the stage's edges, as the camera has it now. */
  private spared: { top: number; bottom: number } | null = null;
  private pose: ArrayLike<number> | null = null;
  /** The face stands where this camera sees it; null: free, in the middle. */
  private lens: Lens | null = null;
  /** Drawn by the processor. */
  readonly software: boolean;
  view: View = 'shaded';
  private covered = { top: 0, bottom: 0 };
  /** Pictures of a face drawn since the start. */
  drawn = 0;
  /** Called where something came to be known, or is not any more: isKnown(). */
  knowledgeChanged: () => void = () => {};
  /** Called before every picture: where the lens's own picture lies on the canvas, CSS pixels; null without a lens. */
  beforeDrawing: (place: { left: number; top: number; scale: number } | null) => void = () => {};
  /** Called with every picture. */
  afterDrawing: () => void = () => {};
  /** A press on the face that was no turn of it, at a vertex. */
  pressed: ((vertex: number) => void) | null = null;

  /** Throws where there is no WebGL 2. */
  constructor(private readonly canvas: HTMLCanvasElement, private readonly detailChanged: () => void) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: 'high-performance' });
    this.software = isSoftware(this.renderer);
    this.chooser = new DetailChooser(this.software);
    const options = { glslVersion: THREE.GLSL3, uniforms: this.uniforms, vertexShader };
    this.surface = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.RawShaderMaterial({
      ...options, fragmentShader, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }));
    this.wire = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.RawShaderMaterial({
      ...options, fragmentShader: lineShader, transparent: true, depthWrite: false }));
    for (const object of [this.surface, this.wire]) {
      object.frustumCulled = false;
      this.head.add(object);
    }
    this.wire.visible = false;
    this.scene.add(this.head);
    new ResizeObserver(() => this.request()).observe(canvas);
    this.listen();
  }

  /** Which of the details it is; 0: all. */
  get detail(): number {
    return this.chooser.step;
  }

  /** What notes and controls cover at the stage's edges, px: the face stands between. */
  setCovered(top: number, bottom: number): void {
    if (top !== this.covered.top || bottom !== this.covered.bottom) {
      this.covered = { top, bottom };
      this.request();
    }
  }

  /** A new topology: triangles [count][3] of each level, coarse to fine. All are of the finest level's
      vertices, vertexCount of them: a coarser level uses the first. */
  setSubject(levels: Uint32Array[], vertexCount: number): void {
    this.levels = levels;
    this.vertexCount = vertexCount;
    this.nothing = new Uint8Array(vertexCount);
    this.placed = false;
    this.drawnLevel = -1;
    this.edgesDrawn = false;
    this.uniforms.has_albedo.value = false;
    this.uniforms.has_confidence.value = false;
    this.uniforms.has_regions.value = false;
    this.uniforms.has_relief.value = false;
    for (const object of [this.surface, this.wire]) {
      object.geometry.dispose();
      object.geometry = new THREE.BufferGeometry();
    }
    this.knowledgeChanged();
  }

  /** Linear colours [vertex][3] of 65535 = scale; one of another subject is passed over. */
  setAlbedo(linear: Uint16Array, scale: number): void {
    if (linear.length !== 3 * this.vertexCount) {
      return;
    }
    this.surface.geometry.setAttribute('color', new THREE.BufferAttribute(linear, 3, true));
    this.uniforms.albedo_scale.value = scale;
    this.uniforms.has_albedo.value = true;
    this.knowledgeChanged();
    this.request();
  }

  /** false: it is not of the topology that is known. */
  setMesh(mesh: FaceMesh): boolean {
    if (mesh.vertices.length !== 3 * this.vertexCount || mesh.normals.length !== mesh.vertices.length) {
      return false;
    }
    this.uniforms.step_mm.value = mesh.stepMm;
    const geometry = this.surface.geometry;
    const position = geometry.getAttribute('position') as THREE.BufferAttribute | undefined;
    const normal = geometry.getAttribute('normal') as THREE.BufferAttribute | undefined;
    if (position && normal) {
      position.array = mesh.vertices;
      position.needsUpdate = true;
      normal.array = mesh.normals;
      normal.needsUpdate = true;
    } else {
      const dynamic = (array: Int16Array, normalized: boolean) => {
        const attribute = new THREE.BufferAttribute(array, 3, normalized);
        attribute.setUsage(THREE.DynamicDrawUsage);
        return attribute;
      };
      geometry.setAttribute('position', dynamic(mesh.vertices, false));
      geometry.setAttribute('normal', dynamic(mesh.normals, true));
      if (!geometry.getAttribute('color')) {
        geometry.setAttribute('color', new THREE.BufferAttribute(new Uint16Array(3 * this.vertexCount), 3, true));
      }
      if (!geometry.getAttribute('region')) {
        geometry.setAttribute('region', new THREE.BufferAttribute(new Uint8Array(3 * this.vertexCount), 3, true));
      }
    }
    const known = mesh.confidence !== null && mesh.confidence.length === this.vertexCount;
    const confidence = known ? mesh.confidence! : this.nothing;
    if (known !== this.uniforms.has_confidence.value) {
      this.uniforms.has_confidence.value = known;
      this.knowledgeChanged();
    }
    const shown = geometry.getAttribute('confidence') as THREE.BufferAttribute | undefined;
    if (!shown) {
      geometry.setAttribute('confidence', new THREE.BufferAttribute(confidence, 1, true));
    } else if (this.view === 'confidence') {
      shown.array = confidence;
      shown.needsUpdate = true;
    }
    if (!this.placed) {
      this.place(mesh);
    }
    this.setCoarse(mesh);
    this.pose = mesh.pose;
    this.request();
    return true;
  }

  /** Where it is not known, the mesh itself stands in its place. */
  private setCoarse(mesh: FaceMesh): void {
    const geometry = this.surface.geometry;
    const set = (name: string, array: Int16Array | Float32Array, size: number, normalized: boolean) => {
      const attribute = geometry.getAttribute(name) as THREE.BufferAttribute | undefined;
      if (attribute) {
        attribute.array = array;
        attribute.needsUpdate = true;
      } else {
        geometry.setAttribute(name, new THREE.BufferAttribute(array, size, normalized).setUsage(THREE.DynamicDrawUsage));
      }
    };
    if (mesh.coarse && mesh.coarseNormals) {
      set('coarse', mesh.coarse, 3, false);
      set('coarse_normal', mesh.coarseNormals, 3, true);
    }
    const known = mesh.relief !== null && mesh.relief.length === this.vertexCount;
    if (known) {
      set('relief', mesh.relief!, 1, false);
    }
    if (known !== this.uniforms.has_relief.value) {
      this.uniforms.has_relief.value = known;
      this.knowledgeChanged();
    }
  }

  /** Where the camera sees it, over its picture; lens null: free. shown, refined: 0 to 1, of the mesh over the picture, and from
      the coarse mesh to the refined one. */
  setOver(lens: Lens | null, shown: number, refined: number): void {
    this.canvas.style.setProperty('--shown', String(lens ? shown : 1));
    this.canvas.dataset.over = lens ? `${shown.toFixed(2)} ${refined.toFixed(2)}` : '';
    const wanted = lens ? refined : 1;
    if (lens !== this.lens || this.wantedRefined !== wanted) {
      this.lens = lens;
      this.wantedRefined = wanted;
      this.request();
    }
  }
  private wantedRefined = 1;

  /** Camera frame to that of the screen: y and z change signs. Without a lens the head stays in the middle and only turns. */
  private placeHead(): void {
    const r = this.pose;
    if (!r) {
      return;
    }
    const [x, y, z] = this.lens ? [r[3], -r[7], -r[11]] : [0, 0, 0];
    const turned = new THREE.Matrix4().set(r[0], r[1], r[2], x, -r[4], -r[5], -r[6], y, -r[8], -r[9], -r[10], z, 0, 0, 0, 1);
    this.head.matrixAutoUpdate = false;
    this.head.matrix.identity();
    if (!this.lens) {
      this.head.matrix.makeTranslation(-this.centre.x, -this.centre.y, -this.centre.z);
    }
    this.head.matrix.premultiply(turned);
  }

  /** Colours of soft regions, sRGB [vertex][3]; null: none. */
  setRegions(colours: Uint8Array | null): void {
    const fits = colours !== null && colours.length === 3 * this.vertexCount && colours.length > 0;
    if (fits) {
      this.surface.geometry.setAttribute('region', new THREE.BufferAttribute(colours, 3, true));
    }
    this.uniforms.has_regions.value = fits;
    this.request();
  }

  /** Head frame to the screen, without the mesh's own integers. */
  private headToWorld(): THREE.Matrix4 {
    this.head.updateMatrixWorld();
    this.camera.updateMatrixWorld();
    return this.head.matrixWorld;
  }

  /** Where a vertex is now, head frame, mm; null where there is none. */
  vertexAt(vertex: number): THREE.Vector3 | null {
    const position = this.surface.geometry.getAttribute('position') as THREE.BufferAttribute | undefined;
    if (!position || vertex >= position.count) {
      return null;
    }
    return new THREE.Vector3(position.array[3 * vertex], position.array[3 * vertex + 1], position.array[3 * vertex + 2]).multiplyScalar(this.uniforms.step_mm.value);
  }

  /** A point of the head on the canvas, CSS pixels from its upper left corner. */
  onCanvas(head_mm: THREE.Vector3): { x: number; y: number } {
    const seen = head_mm.clone().applyMatrix4(this.headToWorld()).project(this.camera);
    return { x: (0.5 + 0.5 * seen.x) * this.canvas.clientWidth, y: (0.5 - 0.5 * seen.y) * this.canvas.clientHeight };
  }

  private ray(x: number, y: number): THREE.Raycaster {
    this.headToWorld();
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2((2 * x) / this.canvas.clientWidth - 1, 1 - (2 * y) / this.canvas.clientHeight), this.camera);
    return caster;
  }

  /** The vertex of the finest mesh nearest to what is seen there; null beside the face. */
  pick(x: number, y: number): number | null {
    const position = this.surface.geometry.getAttribute('position') as THREE.BufferAttribute | undefined;
    if (!position) {
      return null;
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', position);
    geometry.setIndex(new THREE.BufferAttribute(this.levels[this.levels.length - 1], 1));
    const mesh = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ side: THREE.FrontSide }));
    mesh.matrixWorld = this.headToWorld().clone().multiply(new THREE.Matrix4().makeScale(...(Array(3).fill(this.uniforms.step_mm.value) as [number, number, number])));
    const [hit] = this.ray(x, y).intersectObject(mesh, false);
    if (!hit?.face) {
      return null;
    }
    const away = (vertex: number) => this.vertexAt(vertex)!.applyMatrix4(this.head.matrixWorld).distanceTo(hit.point);
    return [hit.face.a, hit.face.b, hit.face.c].reduce((best, vertex) => (away(vertex) < away(best) ? vertex : best));
  }

  /** Where the pointer would have a point of the head: on the plane through it that faces the viewer. Head frame, mm. */
  dragged(from_mm: THREE.Vector3, x: number, y: number): THREE.Vector3 {
    const world = this.headToWorld();
    const towards = this.camera.getWorldDirection(new THREE.Vector3());
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(towards, from_mm.clone().applyMatrix4(world));
    const at = this.ray(x, y).ray.intersectPlane(plane, new THREE.Vector3());
    return at ? at.applyMatrix4(world.clone().invert()) : from_mm.clone();
  }

  /** Whether what a view shows has come with the mesh. */
  isKnown(view: View): boolean {
    const { has_albedo, has_confidence, has_relief } = this.uniforms;
    return (view !== 'albedo' || has_albedo.value) && (view !== 'confidence' || has_confidence.value) && (view !== 'relief' || has_relief.value);
  }

  setView(view: View): void {
    this.view = view;
    this.uniforms.view.value = kViews.indexOf(view);
    this.wire.visible = view === 'wire';
    this.request();
  }

  /** Turns the face by hand, radians; zoom is a factor. */
  turnBy(yaw: number, pitch: number, zoom = 1): void {
    const limited = (value: number, most: number) => Math.max(-most, Math.min(most, value));
    this.turn.yaw = limited(this.turn.yaw + yaw, 1.5);
    this.turn.pitch = limited(this.turn.pitch + pitch, 0.9);
    this.turn.zoom = Math.max(0.5, Math.min(4, this.turn.zoom * zoom));
    this.request();
  }
  turnBack(): void {
    this.turn = { yaw: 0, pitch: 0, zoom: 1 };
    this.request();
  }

  private listen(): void {
    const pointers = new Map<number, PointerEvent>();
    this.canvas.addEventListener('pointerdown', (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, event);
    });
    this.canvas.addEventListener('pointermove', (event) => {
      const before = pointers.get(event.pointerId);
      if (before && pointers.size === 1) {
        this.turnBy((event.clientX - before.clientX) * 0.006, (event.clientY - before.clientY) * 0.006);
      } else if (before) {
        const other = [...pointers.values()].find((entry) => entry.pointerId !== event.pointerId);
        const apart = (at: PointerEvent) => Math.hypot(at.clientX - other!.clientX, at.clientY - other!.clientY) || 1;
        this.turnBy(0, 0, apart(event) / apart(before));
      }
      if (before) {
        pointers.set(event.pointerId, event);
      }
    });
    let down: PointerEvent | null = null;
    this.canvas.addEventListener('pointerdown', (event) => { down = pointers.size === 1 ? event : null; });
    this.canvas.addEventListener('pointerup', (event) => {
      if (down && this.pressed && Math.hypot(event.clientX - down.clientX, event.clientY - down.clientY) < kPress_px) {
        const vertex = this.pick(event.offsetX, event.offsetY);
        if (vertex !== null) {
          this.pressed(vertex);
        }
      }
    });
    const end = (event: PointerEvent) => pointers.delete(event.pointerId);
    this.canvas.addEventListener('pointerup', end);
    this.canvas.addEventListener('pointercancel', end);
    this.canvas.addEventListener('dblclick', () => { if (!this.pressed) this.turnBack(); });
    this.canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.turnBy(0, 0, Math.exp(-event.deltaY * 0.001));
    }, { passive: false });
    this.canvas.addEventListener('keydown', (event) => {
      const turns: Record<string, [number, number, number]> = {
        ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, -0.1, 1], ArrowDown: [0, 0.1, 1], '+': [0, 0, 1.1], '-': [0, 0, 1 / 1.1] };
      if (event.key in turns) {
        this.turnBy(...turns[event.key]);
        event.preventDefault();
      } else if (event.key === '0') {
        this.turnBack();
      }
    });
  }

  /** Middle and size of the mesh, once for each subject, so that nothing jumps. */
  private place(mesh: FaceMesh): void {
    const box = new THREE.Box3();
    const point = new THREE.Vector3();
    for (let i = 0; i < mesh.vertices.length; i += 3) {
      box.expandByPoint(point.set(mesh.vertices[i], mesh.vertices[i + 1], mesh.vertices[i + 2]).multiplyScalar(mesh.stepMm));
    }
    box.getCenter(this.centre);
    const size = box.getSize(point);
    this.radius = Math.max(size.x * 1.1, size.y) / 2;
    this.placed = true;
  }

  private request(): void {
    if (!this.pending) {
      this.pending = true;
      requestAnimationFrame((now) => this.draw(now));
    }
  }

  private draw(now_ms: number): void {
    this.pending = false;
    const { detail } = this.chooser;
    if (now_ms - this.lastDrawn_ms < 1000 / detail.mostRate - 2) {
      this.request();
      return;
    }
    this.lastDrawn_ms = now_ms;
    this.fit(detail);
    const began = performance.now();
    this.renderer.render(this.scene, this.camera);
    if (this.software || this.drawn % 15 === 0) {
      // Commands are only queued: what they cost shows once one waits for them.
      const gl = this.renderer.getContext();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      if (this.chooser.judge(performance.now() - began)) {
        this.detailChanged();
      }
    }
    if (this.placed) {
      ++this.drawn;
      this.canvas.dataset.drawn = String(this.drawn);
    }
    this.afterDrawing();
  }

  /** Size, triangles and camera, as they are wanted now. */
  private fit(detail: Detail): void {
    const width = this.canvas.clientWidth || 1;
    const height = this.canvas.clientHeight || 1;
    const ratio = detail.pixelRatio >= 2 ? Math.min(window.devicePixelRatio, 2) : detail.pixelRatio;
    if (this.renderer.getPixelRatio() !== ratio || this.canvas.width !== Math.floor(width * ratio) || this.canvas.height !== Math.floor(height * ratio)) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
    }
    const geometry = this.surface.geometry;
    const position = geometry.getAttribute('position') as THREE.BufferAttribute | undefined;
    const level = levelFor(this.levels.map((triangles) => triangles.length / 3), detail.mostTriangles);
    if (position && this.placed && this.drawnLevel !== level) {
      geometry.setIndex(new THREE.BufferAttribute(this.levels[level], 1));
      this.canvas.dataset.triangles = String(this.levels[level].length / 3);
      this.drawnLevel = level;
      this.edgesDrawn = false;
    }
    if (position && this.view === 'wire' && !this.edgesDrawn && geometry.index) {
      const lines = new THREE.BufferGeometry();
      for (const name of ['position', 'normal', 'coarse', 'coarse_normal', 'color', 'region', 'confidence', 'relief']) {
        if (geometry.getAttribute(name)) {
          lines.setAttribute(name, geometry.getAttribute(name));
        }
      }
      lines.setIndex(new THREE.BufferAttribute(edgesOf(geometry.index.array as Uint32Array), 1));
      this.wire.geometry = lines;
      this.edgesDrawn = true;
    }
    this.uniforms.refined.value = geometry.getAttribute('coarse') ? this.wantedRefined : 1;
    const free = this.spare(height);
    this.placeHead();
    if (this.lens) {
      this.lookThrough(this.lens, width, height, free);
    } else {
      this.beforeDrawing(null);
      this.aim(width, height, free);
    }
  }

  /** The height that notes and controls leave free; it goes to where it should be with a pace. */
  private spare(height: number): number {
    const most = (1 - kLeastFree) * height;
    const scale = Math.min(1, most / Math.max(1, this.covered.top + this.covered.bottom));
    const wanted = { top: scale * this.covered.top, bottom: scale * this.covered.bottom };
    const now = this.spared ?? wanted;
    const near = Math.abs(wanted.top - now.top) + Math.abs(wanted.bottom - now.bottom) < 2;
    const towards = (from: number, to: number) => (near ? to : from + kPace * (to - from));
    this.spared = { top: towards(now.top, wanted.top), bottom: towards(now.bottom, wanted.bottom) };
    if (!near) {
      this.request();
    }
    return height - this.spared.top - this.spared.bottom;
  }

  /** The camera's own eye: its whole picture lies in what is free, and the mesh where it sees the face. */
  private lookThrough(lens: Lens, width: number, height: number, free: number): void {
    const scale = Math.min(width / lens.width, free / lens.height);
    const left = (width - scale * lens.width) / 2;
    const top = this.spared!.top + (free - scale * lens.height) / 2;
    const { near, far } = this.camera;
    // A pixel's middle is half a pixel from its edge. Clip space: w is the distance before the camera, -z.
    const sign = lens.mirrored ? -1 : 1;
    const middle_x = left + scale * (lens.mirrored ? lens.width - lens.cx - 0.5 : lens.cx + 0.5);
    const middle_y = top + scale * (lens.cy + 0.5);
    this.camera.view = null;
    this.camera.position.set(0, 0, 0);
    this.camera.quaternion.identity();
    this.camera.projectionMatrix.set(
      (sign * 2 * scale * lens.fx) / width, 0, 1 - (2 * middle_x) / width, 0,
      0, (2 * scale * lens.fy) / height, (2 * middle_y) / height - 1, 0,
      0, 0, -(far + near) / (far - near), (-2 * far * near) / (far - near),
      0, 0, -1, 0);
    this.camera.projectionMatrixInverse.copy(this.camera.projectionMatrix).invert();
    this.beforeDrawing({ left, top, scale });
  }

  /** The camera, so that the face stands in the middle of what notes and controls leave free. */
  private aim(width: number, height: number, free: number): void {
    const angle = THREE.MathUtils.degToRad(this.camera.fov / 2);
    const { yaw, pitch, zoom } = this.turn;
    const fitting = ((1.1 * height) / free) * this.radius / Math.tan(angle) / Math.min(1, (1.15 * width) / free);
    this.camera.aspect = width / height;
    this.camera.position.set(-Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch));
    this.camera.position.multiplyScalar(fitting / zoom);
    this.camera.lookAt(0, 0, 0);
    this.camera.setViewOffset(width, height, 0, (this.spared!.bottom - this.spared!.top) / 2, width, height);
  }
}
