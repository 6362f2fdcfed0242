// The pad in three dimensions: surface as it is deformed, an arrow at each node, the wrench at the centre of pressure.
// The sensor's own axes: x, y along the pad, z out of it, seen from where things touch.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { SensorInfo } from "../board";
import { type Contacts, type Field, NOT_MEASURED, VALID, type Wrench } from "../results";
import { arrowGeometry, writeArrow } from "./arrow";
import { linear, sequentialLight, wheelLight } from "./colours";
import { orbit } from "./orbit";
import { Quality } from "./quality";
import { SoftwareRenderer } from "./software";

export type Tint = "normal" | "slip" | "plain";

const EXAGGERATION = 4; // of the depth of the surface
const ARROW_PART = 0.22; // of the pad's length: an arrow of full scale
const WIDEST_PART = 0.15; // of the pad's length: no arrow is wider
const SMALLEST_PART = 0.01; // of full scale: no arrow below
const WRENCH_PART = 0.45; // of the pad's length: a wrench of full scale
const MIN_PRESS_N = 0.02; // below it a centre of pressure is noise
const SLIP_TINTS = [[0.32, 0.35, 0.4], [0.0, 0.45, 0.7], [0.9, 0.6, 0.0]].map((rgb) => rgb.map(linear)); // nothing, sticks, slips
const INVALID_GREY = [0.55, 0.55, 0.55].map(linear);
const LID = [24, 30] as const; // of the corners of a box of three.js: the two triangles of its side at +z
const FINEST_RATIO = 2;
// What a picture may cost. A graphics card's is seen from one picture of the screen to the next: 60 a second take 16.7 ms
// each. The processor's is its own time, and half of that must be left for all the rest.
const CARD_MS = { slow: 25, quick: 18 };
const PROCESSOR_MS = { slow: 9, quick: 4 };

type Drawer = THREE.WebGLRenderer | SoftwareRenderer;

/** Browsers do not always own up to it when they are asked to fail then; these are the names of those that there are. */
function isImitation(context: WebGL2RenderingContext): boolean {
  const said = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(said ? said.UNMASKED_RENDERER_WEBGL : context.RENDERER));
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

/** A graphics card where there is one: a browser's imitation of one is slower than the page itself. */
function makeDrawer(): Drawer {
  const wanted = new URLSearchParams(location.search).get("draw"); // "webgl", "software": for tests, and to compare
  if (wanted === "software") return new SoftwareRenderer();
  const attributes = { antialias: true, preserveDrawingBuffer: true, failIfMajorPerformanceCaveat: wanted !== "webgl" };
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("webgl2", attributes) as WebGL2RenderingContext | null;
  if (context && (wanted === "webgl" || !isImitation(context))) return new THREE.WebGLRenderer({ canvas, context, ...attributes });
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return new SoftwareRenderer();
}

export class Field3d {
  readonly canvas: HTMLCanvasElement;
  tint: Tint = "normal";
  isScaleLocked = false;
  /** Newtons at a node, and in all, that are drawn at full length. */
  nodeFullScaleN = 1e-3;
  wrenchFullScaleN = 1;
  nArrows = 0;
  /** Is there a graphics card that draws? */
  readonly hasCard: boolean;
  private readonly renderer: Drawer;
  private readonly quality: Quality;
  private lastMs: number | undefined; // when the picture before this one was drawn, if it was
  private width = 0;
  private height = 0;
  private readonly scene = new THREE.Scene();
  private readonly camera: THREE.PerspectiveCamera;
  private readonly controls: OrbitControls;
  private readonly size: number;
  private surface: THREE.Mesh<THREE.BufferGeometry, THREE.MeshStandardMaterial> | undefined;
  private arrows: THREE.InstancedMesh | undefined;
  private readonly contactArrows: THREE.InstancedMesh;
  private readonly wrenchArrow: THREE.Mesh<THREE.BufferGeometry, THREE.MeshStandardMaterial>;
  private readonly pressure: THREE.Mesh;
  private readonly target: THREE.Mesh;
  private isDirty = true;
  private readonly place = new THREE.Vector3();
  private readonly force = new THREE.Vector3();
  private readonly matrix = new THREE.Matrix4();

  constructor(private readonly info: SensorInfo, isStill: boolean) {
    this.renderer = makeDrawer();
    this.hasCard = this.renderer instanceof THREE.WebGLRenderer;
    this.canvas = this.renderer.domElement;
    const { slow, quick } = this.hasCard ? CARD_MS : PROCESSOR_MS;
    const own = Math.min(window.devicePixelRatio, FINEST_RATIO);
    // Where no card smooths the edges, a picture that is twice as fine does.
    this.quality = new Quality(this.hasCard ? own : FINEST_RATIO, this.hasCard ? own : 1, slow, quick);
    this.size = info.shape.kind === "flat" ? Math.max(info.padX, info.padY) : 2.4 * info.shape.radius;
    this.camera = new THREE.PerspectiveCamera(32, 1, this.size / 100, this.size * 30);
    this.camera.up.set(0, 0, 1);
    const away = info.shape.kind === "tube" ? 1.3 * Math.max(1, info.shape.length / this.size) : 1.35;
    this.camera.position.set(-0.5 * this.size * away, -1.35 * this.size * away, 1.5 * this.size * away);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.setStill(isStill);
    this.controls.target.set(0, 0, info.shape.kind === "dome" ? -0.3 * info.shape.radius : 0);
    this.controls.addEventListener("change", () => (this.isDirty = true));
    this.controls.update();
    this.controls.saveState();
    const light = new THREE.DirectionalLight(0xffffff, 1.6);
    light.position.set(-1, -0.6, 2);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x667788, 1.8), light, this.body(), this.axes());
    const geometry = arrowGeometry();
    this.contactArrows = new THREE.InstancedMesh(geometry, new THREE.MeshStandardMaterial({ color: 0xe69f00 }), 8);
    this.contactArrows.count = 0;
    this.contactArrows.frustumCulled = false;
    this.wrenchArrow = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color: 0xd55e00, transparent: true, opacity: 0.85 }));
    this.pressure = new THREE.Mesh(
      new THREE.RingGeometry(0.018 * this.size, 0.027 * this.size, 32),
      new THREE.MeshBasicMaterial({ color: 0xd55e00, side: THREE.DoubleSide, depthTest: false }),
    );
    this.target = new THREE.Mesh(
      new THREE.RingGeometry(0.05 * this.size, 0.062 * this.size, 48),
      new THREE.MeshBasicMaterial({ color: 0xf0e442, side: THREE.DoubleSide, depthTest: false }),
    );
    this.pressure.renderOrder = this.target.renderOrder = 1; // over all the rest
    this.wrenchArrow.visible = this.pressure.visible = this.target.visible = false;
    this.scene.add(this.contactArrows, this.wrenchArrow, this.pressure, this.target);
  }

  /** What a body looks like that does not send its surface. */
  private body(): THREE.Object3D {
    const { shape, padX, padY, thickness } = this.info;
    const material = new THREE.MeshStandardMaterial({ color: 0x8d99ab, side: THREE.DoubleSide });
    if (shape.kind === "tube") {
      // What touches behind it is seen through it.
      Object.assign(material, { transparent: true, opacity: 0.6, depthWrite: false });
      return new THREE.Mesh(new THREE.CylinderGeometry(shape.radius, shape.radius, shape.length, 48, 1, true).rotateX(Math.PI / 2), material);
    }
    if (shape.kind === "dome") {
      const dome = new THREE.SphereGeometry(shape.radius, 48, 16, 0, 2 * Math.PI, 0, Math.PI / 2).rotateX(Math.PI / 2);
      return new THREE.Mesh(dome.translate(0, 0, -shape.radius), material);
    }
    const box = new THREE.BoxGeometry(padX, padY, thickness).translate(0, 0, -thickness / 2);
    // The field's surface is its top, also where that is pressed in: a lid would hide it.
    if (this.info.fieldForces) box.setIndex([...box.index!.array].filter((_, i) => i < LID[0] || i >= LID[1]));
    return new THREE.Mesh(box, material);
  }

  /** x, y, z from a corner, in the colours of the charts. */
  private axes(): THREE.Object3D {
    const group = new THREE.Group();
    const at = new THREE.Vector3(-0.56 * this.info.padX, -0.56 * this.info.padY, 0);
    if (this.info.shape.kind !== "flat") at.set(-0.55 * this.size, -0.55 * this.size, -0.3 * this.size);
    ([["x", 0xe69f00], ["y", 0x56b4e9], ["z", 0x009e73]] as const).forEach(([name, colour], i) => {
      const direction = new THREE.Vector3().setComponent(i, 1);
      const length = 0.16 * this.size;
      group.add(new THREE.ArrowHelper(direction, at, length, colour, 0.25 * length, 0.14 * length));
      const label = new THREE.Sprite(new THREE.SpriteMaterial({ map: letter(name, colour), depthTest: false }));
      label.position.copy(at).addScaledVector(direction, 1.2 * length);
      label.scale.setScalar(0.055 * this.size);
      group.add(label);
    });
    return group;
  }

  moveField(field: Field): void {
    if (field.nX < 2 || field.nY < 2) return;
    const n = field.nX * field.nY;
    if (!this.surface || this.arrows?.instanceMatrix.count !== n) this.make(field);
    if (!this.isScaleLocked) this.nodeFullScaleN = Math.max(0.995 * this.nodeFullScaleN, largest(field), 1e-3);
    this.moveSurface(field);
    this.moveArrows(field);
    this.isDirty = true;
  }

  private make(field: Field): void {
    if (this.surface) this.scene.remove(this.surface);
    if (this.arrows) this.scene.remove(this.arrows);
    const geometry = new THREE.PlaneGeometry(1, 1, field.nX - 1, field.nY - 1);
    geometry.index!.array.reverse(); // its rows go down, those of a pad along y: its front is seen from +z
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * field.nX * field.nY), 3));
    this.surface = new THREE.Mesh(
      geometry,
      new THREE.MeshStandardMaterial({ vertexColors: true, side: THREE.DoubleSide, roughness: 0.9 }),
    );
    this.arrows = new THREE.InstancedMesh(arrowGeometry(), new THREE.MeshStandardMaterial({ roughness: 0.7 }), field.nX * field.nY);
    this.arrows.instanceColor = new THREE.InstancedBufferAttribute(new Float32Array(3 * field.nX * field.nY), 3);
    for (const own of [this.arrows.instanceMatrix, this.arrows.instanceColor, ...Object.values(geometry.attributes)]) (own as THREE.BufferAttribute).setUsage(THREE.DynamicDrawUsage);
    this.arrows.frustumCulled = this.surface.frustumCulled = false;
    this.scene.add(this.surface, this.arrows);
  }

  private placeOf(field: Field, node: number): THREE.Vector3 {
    const { grid } = this.info;
    const [u, i] = [field.displacement, 3 * node];
    return this.place.set(
      grid.originX + (node % field.nX) * grid.stepX + (u ? u[i]! : 0),
      grid.originY + Math.floor(node / field.nX) * grid.stepY + (u ? u[i + 1]! : 0),
      EXAGGERATION * (u ? u[i + 2]! : 0),
    );
  }

  private moveSurface(field: Field): void {
    const { position, normal, color } = this.surface!.geometry.attributes as Record<string, THREE.BufferAttribute>;
    const [places, colours] = [position!.array as Float32Array, color!.array as Float32Array];
    for (let node = 0; node < field.nX * field.nY; node++) {
      const p = this.placeOf(field, node);
      places[3 * node] = p.x;
      places[3 * node + 1] = p.y;
      places[3 * node + 2] = p.z;
      this.tintOf(field, node, colours);
    }
    writeNormals(places, field.nX, field.nY, normal!.array as Float32Array);
    position!.needsUpdate = normal!.needsUpdate = color!.needsUpdate = true;
  }

  private tintOf(field: Field, node: number, out: Float32Array): void {
    if (this.tint === "normal" && field.validity[2] === VALID) {
      sequentialLight(-field.force[3 * node + 2]! / this.nodeFullScaleN, out, 3 * node);
      return;
    }
    const slips = this.tint === "slip" && field.slip ? field.slip[node]! : 0;
    out.set(SLIP_TINTS[slips] ?? SLIP_TINTS[0]!, 3 * node);
  }

  private moveArrows(field: Field): void {
    const arrows = this.arrows!;
    const matrices = arrows.instanceMatrix.array as Float32Array;
    const colours = arrows.instanceColor!.array as Float32Array;
    const isValid = field.validity.every((v) => v === VALID || v === NOT_MEASURED);
    const [x, y, z] = field.validity.map((v) => (v === NOT_MEASURED ? 0 : 1)) as [number, number, number];
    const least = (SMALLEST_PART * this.nodeFullScaleN) ** 2;
    const lengthPerN = (ARROW_PART * this.size) / this.nodeFullScaleN;
    let n = 0;
    for (let node = 0; node < field.nX * field.nY; node++) {
      const [fx, fy, fz] = [x * field.force[3 * node]!, y * field.force[3 * node + 1]!, z * field.force[3 * node + 2]!];
      if (fx * fx + fy * fy + fz * fz < least) continue;
      writeArrow(matrices, 16 * n, this.placeOf(field, node), fx, fy, fz, lengthPerN, WIDEST_PART * this.size, 0.8);
      if (isValid) wheelLight(Math.atan2(fy, fx), colours, 3 * n);
      else colours.set(INVALID_GREY, 3 * n);
      n++;
    }
    arrows.count = this.nArrows = n;
    arrows.instanceMatrix.needsUpdate = arrows.instanceColor!.needsUpdate = true;
  }

  /** An arrow that ends at `place`, along `force`, into `matrix`; `lengthPerN` of the pad's length. */
  private pose(lengthPerN: number): void {
    const { x, y, z } = this.force;
    writeArrow(this.matrix.elements, 0, this.place, x, y, z, lengthPerN * this.size, WIDEST_PART * this.size, 0.9);
  }

  /** The whole force, ending at the centre of pressure; nothing where either is not known. */
  showWrench(wrench: Wrench): void {
    const [fx, fy, fz, tx, ty] = wrench.values as [number, number, number, number, number];
    const isForce = wrench.validity[2] === VALID;
    const size = Math.hypot(fx || 0, fy || 0, fz || 0);
    if (!this.isScaleLocked && isForce) this.wrenchFullScaleN = Math.max(0.998 * this.wrenchFullScaleN, size, 0.2);
    this.wrenchArrow.visible = isForce && size > MIN_PRESS_N && this.info.shape.kind === "flat";
    const hasCentre = -fz > MIN_PRESS_N && wrench.validity[3] === VALID && wrench.validity[4] === VALID;
    this.pressure.visible = this.wrenchArrow.visible && hasCentre;
    if (this.wrenchArrow.visible) {
      // Torque = X x F with X = (x, y, 0).
      this.place.set(hasCentre ? -ty / fz : 0, hasCentre ? tx / fz : 0, 0.002 * this.size);
      this.pressure.position.copy(this.place);
      this.force.set(fx || 0, fy || 0, fz);
      this.pose(WRENCH_PART / this.wrenchFullScaleN);
      this.matrix.decompose(this.wrenchArrow.position, this.wrenchArrow.quaternion, this.wrenchArrow.scale);
    }
    this.isDirty = true;
  }

  /** An arrow at each contact of a sensor that sends no field. */
  showContacts(contacts: Contacts): void {
    if (this.info.fieldForces) return;
    let n = 0;
    for (const contact of contacts.contacts.slice(0, 8)) {
      const [x, y] = contact.center;
      const normal = (contact.skin ?? contact.tool)?.normalForceN;
      if (normal) this.force.fromArray(normal.map((f) => f || 0));
      else this.force.fromArray(contact.force.map((f) => f || 0));
      if (contact.skin) this.place.fromArray(contact.skin.placeM);
      else if (this.info.shape.kind === "dome") this.place.set(x, y, Math.sqrt(Math.max(this.info.shape.radius ** 2 - x * x - y * y, 0)) - this.info.shape.radius);
      else if (this.info.shape.kind === "flat") this.place.set(x, y, 0);
      else continue;
      const size = this.force.length();
      if (!(size > 0)) continue;
      if (!this.isScaleLocked) this.wrenchFullScaleN = Math.max(this.wrenchFullScaleN, size);
      this.pose(WRENCH_PART / this.wrenchFullScaleN);
      this.contactArrows.setMatrixAt(n++, this.matrix);
    }
    this.contactArrows.count = n;
    this.contactArrows.instanceMatrix.needsUpdate = true;
    this.isDirty = true;
  }

  /** A ring on the pad where to press next, millimetres; none. */
  aim(target: { x: number; y: number } | undefined): void {
    const isFlat = this.info.shape.kind === "flat"; // places on a tube or a dome are not on a plane
    this.target.visible = target !== undefined && isFlat;
    if (target) this.target.position.set(1e-3 * target.x, 1e-3 * target.y, 0.004 * this.size);
    this.isDirty = true;
  }

  setBackground(colour: string): void {
    this.scene.background = new THREE.Color(colour);
    this.isDirty = true;
  }

  /** Nothing goes on moving by itself. */
  setStill(isStill: boolean): void {
    this.controls.enableDamping = !isStill;
  }

  /** Where it is seen from, of its size, from what is looked at. */
  get seenFrom(): number[] {
    return this.camera.position.clone().sub(this.controls.target).divideScalar(this.size).toArray();
  }

  /** A key was pressed on it; false: it is none of its own. */
  press(key: string): boolean {
    if (key === "Home") this.reset();
    const { target } = this.controls;
    const from = this.camera.position.clone().sub(target);
    const place = key === "Home" ? undefined : orbit([from.x, from.y, from.z], key);
    if (place) {
      this.camera.position.set(...place).add(target);
      this.camera.lookAt(target);
    }
    this.isDirty = true;
    return key === "Home" || place !== undefined;
  }

  /** As seen at first. */
  reset(): void {
    this.controls.reset();
    this.isDirty = true;
  }

  /** The size of the place that it fills, CSS pixels. */
  resize(width: number, height: number): void {
    [this.width, this.height] = [width, height];
  }

  drawScene(nowMs: number): void {
    this.fit();
    this.controls.update();
    if (!this.isDirty) {
      this.lastMs = undefined;
      return;
    }
    this.isDirty = false;
    const begin = performance.now();
    this.renderer.render(this.scene, this.camera);
    if (!this.hasCard) this.quality.note(performance.now() - begin);
    else if (this.lastMs !== undefined) this.quality.note(nowMs - this.lastMs);
    this.lastMs = nowMs;
  }

  private fit(): void {
    const { width, height, quality, canvas } = this;
    if (!width || !height || (canvas.width === Math.floor(width * quality.ratio) && canvas.height === Math.floor(height * quality.ratio))) return;
    if (this.renderer instanceof SoftwareRenderer) this.renderer.setSize(width, height, quality.ratio);
    else {
      this.renderer.setPixelRatio(quality.ratio);
      this.renderer.setSize(width, height, false);
    }
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.isDirty = true;
  }

  /** Give the browser its memory back. */
  close(): void {
    this.controls.dispose();
    this.renderer.dispose();
    if (this.renderer instanceof THREE.WebGLRenderer) this.renderer.forceContextLoss();
  }
}

/** Of a surface of nX x nY places: across what its neighbours span. */
function writeNormals(places: Float32Array, nX: number, nY: number, out: Float32Array): void {
  for (let node = 0; node < nX * nY; node++) {
    const [x, y] = [node % nX, Math.floor(node / nX)];
    const [left, right] = [3 * (x > 0 ? node - 1 : node), 3 * (x < nX - 1 ? node + 1 : node)];
    const [up, down] = [3 * (y > 0 ? node - nX : node), 3 * (y < nY - 1 ? node + nX : node)];
    const [ax, ay, az] = [places[right]! - places[left]!, places[right + 1]! - places[left + 1]!, places[right + 2]! - places[left + 2]!];
    const [bx, by, bz] = [places[down]! - places[up]!, places[down + 1]! - places[up + 1]!, places[down + 2]! - places[up + 2]!];
    const [nx, ny, nz] = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
    const per = 1 / (Math.sqrt(nx * nx + ny * ny + nz * nz) || 1);
    out[3 * node] = nx * per;
    out[3 * node + 1] = ny * per;
    out[3 * node + 2] = nz * per;
  }
}

/** The largest nodal force in its measured axes. */
function largest(field: Field): number {
  let most = 0;
  for (let i = 0; i < field.force.length; i++) {
    if (field.validity[i % 3] !== NOT_MEASURED) most = Math.max(most, Math.abs(field.force[i]!));
  }
  return most;
}

function letter(name: string, colour: number): THREE.Texture {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const context = canvas.getContext("2d")!;
  context.font = "bold 52px sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillStyle = `#${colour.toString(16).padStart(6, "0")}`;
  context.fillText(name, 32, 32);
  return new THREE.CanvasTexture(canvas);
}
