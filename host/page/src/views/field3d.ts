// The pad in three dimensions: surface as it is deformed, an arrow at each node, the wrench at the centre of pressure.
// The sensor's own axes: x, y along the pad, z out of it, seen from where things touch.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { SensorInfo } from "../board";
import { type Contacts, type Field, NOT_MEASURED, VALID, type Wrench } from "../results";
import { type Rgb, sequential, wheel } from "./colours";

export type Tint = "normal" | "slip" | "plain";

const EXAGGERATION = 4; // of the depth of the surface
const ARROW_PART = 0.22; // of the pad's length: an arrow of full scale
const SMALLEST_PART = 0.01; // of full scale: no arrow below
const WRENCH_PART = 0.45; // of the pad's length: a wrench of full scale
const MIN_PRESS_N = 0.02; // below it a centre of pressure is noise
const SLIP_TINTS: Rgb[] = [[0.32, 0.35, 0.4], [0.0, 0.45, 0.7], [0.9, 0.6, 0.0]]; // nothing, sticks, slips
const INVALID_GREY: Rgb = [0.55, 0.55, 0.55];

/** An arrow of length 1 that ends in the origin and comes from +z: a load on a surface. */
function arrowGeometry(): THREE.BufferGeometry {
  // radius over height, from the tip up: a head of a third, then the shaft
  const outline = [[0, 0], [0.13, 0.36], [0.05, 0.36], [0.05, 1], [0, 1]].map(([r, h]) => new THREE.Vector2(r, h));
  return new THREE.LatheGeometry(outline, 8).rotateX(Math.PI / 2);
}

export class Field3d {
  readonly canvas: HTMLCanvasElement;
  tint: Tint = "normal";
  isScaleLocked = false;
  /** Newtons at a node, and in all, that are drawn at full length. */
  nodeFullScaleN = 1e-3;
  wrenchFullScaleN = 1;
  nArrows = 0;
  private readonly renderer: THREE.WebGLRenderer;
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
  private readonly turn = new THREE.Quaternion();
  private readonly stretch = new THREE.Vector3();
  private readonly matrix = new THREE.Matrix4();
  private readonly colour = new THREE.Color();
  private readonly rgb: Rgb = [0, 0, 0];

  /** Throws where the browser has no WebGL. */
  constructor(private readonly info: SensorInfo, isStill: boolean) {
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.canvas = this.renderer.domElement;
    this.size = info.shape.kind === "flat" ? Math.max(info.padX, info.padY) : 2.4 * info.shape.radius;
    this.camera = new THREE.PerspectiveCamera(32, 1, this.size / 100, this.size * 30);
    this.camera.up.set(0, 0, 1);
    const away = info.shape.kind === "tube" ? 1.3 * Math.max(1, info.shape.length / this.size) : 1.35;
    this.camera.position.set(-0.5 * this.size * away, -1.35 * this.size * away, 1.5 * this.size * away);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = !isStill;
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
    const slab = new THREE.Mesh(new THREE.BoxGeometry(padX, padY, thickness), material);
    slab.position.z = -thickness / 2 - (this.info.fieldForces ? 0.02 * this.size : 0);
    return slab;
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

  showField(field: Field): void {
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
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * field.nX * field.nY), 3));
    this.surface = new THREE.Mesh(
      geometry,
      new THREE.MeshStandardMaterial({ vertexColors: true, side: THREE.DoubleSide, roughness: 0.9 }),
    );
    this.arrows = new THREE.InstancedMesh(arrowGeometry(), new THREE.MeshStandardMaterial({ roughness: 0.7 }), field.nX * field.nY);
    this.arrows.instanceMatrix.setUsage(THREE.DynamicDrawUsage);
    this.arrows.frustumCulled = this.surface.frustumCulled = false;
    this.scene.add(this.surface, this.arrows);
  }

  private nodeAt(field: Field, node: number): THREE.Vector3 {
    const { grid } = this.info;
    const [u, i] = [field.displacement, 3 * node];
    return this.place.set(
      grid.originX + (node % field.nX) * grid.stepX + (u ? u[i]! : 0),
      grid.originY + Math.floor(node / field.nX) * grid.stepY + (u ? u[i + 1]! : 0),
      EXAGGERATION * (u ? u[i + 2]! : 0),
    );
  }

  private moveSurface(field: Field): void {
    const positions = this.surface!.geometry.getAttribute("position") as THREE.BufferAttribute;
    const colours = this.surface!.geometry.getAttribute("color") as THREE.BufferAttribute;
    for (let node = 0; node < field.nX * field.nY; node++) {
      const p = this.nodeAt(field, node);
      positions.setXYZ(node, p.x, p.y, p.z);
      const [r, g, b] = this.tintOf(field, node);
      this.colour.setRGB(r, g, b, THREE.SRGBColorSpace);
      colours.setXYZ(node, this.colour.r, this.colour.g, this.colour.b);
    }
    positions.needsUpdate = colours.needsUpdate = true;
    this.surface!.geometry.computeVertexNormals();
  }

  private tintOf(field: Field, node: number): Rgb {
    if (this.tint === "slip" && field.slip) return SLIP_TINTS[field.slip[node]!] ?? SLIP_TINTS[0]!;
    if (this.tint === "normal" && field.validity[2] === VALID) {
      return sequential(-field.force[3 * node + 2]! / this.nodeFullScaleN, this.rgb);
    }
    return SLIP_TINTS[0]!;
  }

  private moveArrows(field: Field): void {
    const arrows = this.arrows!;
    const isValid = field.validity.every((v) => v === VALID || v === NOT_MEASURED);
    let n = 0;
    for (let node = 0; node < field.nX * field.nY; node++) {
      for (let k = 0; k < 3; k++) {
        this.force.setComponent(k, field.validity[k] === NOT_MEASURED ? 0 : field.force[3 * node + k]!);
      }
      if (this.force.length() < SMALLEST_PART * this.nodeFullScaleN) continue;
      const shear = Math.atan2(this.force.y, this.force.x);
      this.pose(this.nodeAt(field, node), (ARROW_PART * this.size) / this.nodeFullScaleN, 0.8);
      arrows.setMatrixAt(n, this.matrix);
      const [r, g, b] = isValid ? wheel(shear) : INVALID_GREY;
      arrows.setColorAt(n++, this.colour.setRGB(r, g, b, THREE.SRGBColorSpace));
    }
    arrows.count = this.nArrows = n;
    arrows.instanceMatrix.needsUpdate = true;
    if (arrows.instanceColor) arrows.instanceColor.needsUpdate = true;
  }

  /** An arrow that ends at `place`, along `force`; `fat` of the usual thickness. */
  private pose(place: THREE.Vector3, lengthPerN: number, fat: number): void {
    const length = Math.max(this.force.length() * lengthPerN, 1e-9);
    const width = fat * Math.min(length, 0.15 * this.size);
    this.stretch.copy(this.force).multiplyScalar(-1).normalize();
    this.turn.setFromUnitVectors(Z, this.stretch);
    this.matrix.compose(place, this.turn, this.stretch.set(width, width, length));
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
      this.pose(this.place, (WRENCH_PART * this.size) / this.wrenchFullScaleN, 0.9);
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
      if (contact.normalForceN) this.force.fromArray(contact.normalForceN);
      else this.force.fromArray(contact.force.map((f) => f || 0));
      if (contact.placeM) this.place.fromArray(contact.placeM);
      else if (this.info.shape.kind === "dome") this.place.set(x, y, Math.sqrt(Math.max(this.info.shape.radius ** 2 - x * x - y * y, 0)) - this.info.shape.radius);
      else if (this.info.shape.kind === "flat") this.place.set(x, y, 0);
      else continue;
      const size = this.force.length();
      if (!(size > 0)) continue;
      if (!this.isScaleLocked) this.wrenchFullScaleN = Math.max(this.wrenchFullScaleN, size);
      this.pose(this.place, (WRENCH_PART * this.size) / this.wrenchFullScaleN, 0.9);
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

  /** As seen at first. */
  reset(): void {
    this.controls.reset();
    this.isDirty = true;
  }

  draw(): void {
    const { clientWidth: w, clientHeight: h } = this.canvas.parentElement!;
    const ratio = Math.min(window.devicePixelRatio, 2);
    if (w && h && (this.canvas.width !== Math.floor(w * ratio) || this.canvas.height !== Math.floor(h * ratio))) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(w, h);
      this.camera.aspect = w / h;
      this.camera.updateProjectionMatrix();
      this.isDirty = true;
    }
    this.controls.update();
    if (!this.isDirty) return;
    this.isDirty = false;
    this.renderer.render(this.scene, this.camera);
  }

  /** Give the browser its memory back. */
  close(): void {
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}

const Z = new THREE.Vector3(0, 0, 1);

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
