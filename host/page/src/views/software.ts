// Draws a scene of three.js with the processor: meshes, instances, lines and letters, as far as this page uses them.
// On a computer without a graphics card this is many times as fast as the browser's own imitation of one.

import * as THREE from "three";
import { Raster } from "./raster";

const N_SHADES = 4096;
// Light that is linear, 0 to 1, to a byte of the screen (sRGB); half a step more, because pixels are cut off, not rounded.
const SHADES = Float32Array.from({ length: N_SHADES + 1 }, (_, i) => {
  const c = i / N_SHADES;
  return Math.min(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055) + 0.5, 255);
});
const LINE_PX = 1.5;

const shade = (light: number): number => SHADES[Math.min(Math.max(light * N_SHADES, 0), N_SHADES) | 0]!;

type Drawn = THREE.MeshStandardMaterial | THREE.MeshBasicMaterial;

export class SoftwareRenderer {
  readonly domElement = document.createElement("canvas");
  private readonly context = this.domElement.getContext("2d", { alpha: false })!;
  private readonly raster = new Raster();
  private image = new ImageData(1, 1);
  private readonly seen = new THREE.Matrix4(); // from the world to the picture
  private readonly world = new THREE.Matrix4();
  private readonly whole = new THREE.Matrix4();
  private readonly colour = new THREE.Color();
  private readonly at = new THREE.Vector4();
  // Lights: towards the sun, and its strength; what comes from above and below, by colour.
  private readonly sun = new THREE.Vector3();
  private sunLight = 0;
  private readonly above = new THREE.Color(0);
  private readonly below = new THREE.Color(0);

  setSize(width: number, height: number, ratio: number): void {
    const [w, h] = [Math.max(Math.floor(width * ratio), 1), Math.max(Math.floor(height * ratio), 1)];
    [this.domElement.width, this.domElement.height] = [w, h];
    this.image = new ImageData(w, h);
    this.raster.resize(w, h, new Uint32Array(this.image.data.buffer));
  }

  render(scene: THREE.Scene, camera: THREE.PerspectiveCamera): void {
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    this.seen.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    const background = scene.background instanceof THREE.Color ? scene.background : this.colour.set(0);
    this.raster.clear((0xff000000 | (shade(background.b) << 16) | (shade(background.g) << 8) | shade(background.r)) >>> 0);
    const [solid, clear, over, letters]: [THREE.Object3D[], THREE.Object3D[], THREE.Object3D[], THREE.Sprite[]] = [[], [], [], []];
    scene.traverseVisible((object) => {
      if (object instanceof THREE.Light) this.light(object);
      else if (object instanceof THREE.Sprite) letters.push(object);
      else if (object instanceof THREE.Mesh || object instanceof THREE.Line) {
        const { transparent, depthTest } = object.material as THREE.Material;
        (transparent ? clear : depthTest ? solid : over).push(object);
      }
    });
    for (const object of [...solid, ...clear, ...over]) {
      if (object instanceof THREE.InstancedMesh) this.instances(object);
      else if (object instanceof THREE.Mesh) this.mesh(object.geometry as THREE.BufferGeometry, object.material as Drawn, object.matrixWorld, (object.material as Drawn).color);
      else if (object instanceof THREE.Line) this.line(object);
    }
    this.context.putImageData(this.image, 0, 0);
    for (const sprite of letters) this.letter(sprite, camera);
  }

  private light(light: THREE.Light): void {
    if (light instanceof THREE.HemisphereLight) {
      this.above.copy(light.color).multiplyScalar(light.intensity / Math.PI);
      this.below.copy(light.groundColor).multiplyScalar(light.intensity / Math.PI);
    } else if (light instanceof THREE.DirectionalLight) {
      this.sun.copy(light.position).normalize();
      this.sunLight = light.intensity / Math.PI;
    }
  }

  private instances(mesh: THREE.InstancedMesh): void {
    const material = mesh.material as Drawn;
    const colours = mesh.instanceColor?.array;
    for (let i = 0; i < mesh.count; i++) {
      this.world.fromArray(mesh.instanceMatrix.array, 16 * i).premultiply(mesh.matrixWorld);
      this.mesh(mesh.geometry, material, this.world, colours ? this.colour.fromArray(colours, 3 * i) : material.color);
    }
  }

  private mesh(geometry: THREE.BufferGeometry, material: Drawn, world: THREE.Matrix4, colour: THREE.Color): void {
    const { raster } = this;
    const place = geometry.getAttribute("position").array;
    const colours = material.vertexColors ? geometry.getAttribute("color").array : undefined;
    const n = place.length / 3;
    raster.reserve(n);
    this.project(place, n, world);
    if (material instanceof THREE.MeshBasicMaterial) this.paint(n, colour);
    else this.illuminate(geometry.getAttribute("normal").array, colours, n, world, colour);
    const corners = geometry.index?.array;
    const isTwoSided = material.side === THREE.DoubleSide;
    const alpha = material.transparent ? material.opacity : 1;
    for (let i = 0; i < (corners?.length ?? n); i += 3) {
      const [a, b, c] = corners ? [corners[i]!, corners[i + 1]!, corners[i + 2]!] : [i, i + 1, i + 2];
      raster.triangle(a, b, c, isTwoSided, alpha, !material.depthTest);
    }
  }

  /** Corners to pixels; those behind the eye become no number. */
  private project(place: THREE.TypedArray, n: number, world: THREE.Matrix4): void {
    const { x, y, z, width, height } = this.raster;
    const m = this.whole.multiplyMatrices(this.seen, world).elements as unknown as number[];
    const [m0, m1, m2, m3, m4, m5, m6, m7] = m as [number, number, number, number, number, number, number, number];
    const [m8, m9, m10, m11, m12, m13, m14, m15] = m.slice(8) as [number, number, number, number, number, number, number, number];
    for (let i = 0, k = 0; i < n; i++, k += 3) {
      const [px, py, pz] = [place[k]!, place[k + 1]!, place[k + 2]!];
      const w = m3 * px + m7 * py + m11 * pz + m15;
      const per = w > 0 ? 1 / w : NaN;
      x[i] = (0.5 + 0.5 * (m0 * px + m4 * py + m8 * pz + m12) * per) * width;
      y[i] = (0.5 - 0.5 * (m1 * px + m5 * py + m9 * pz + m13) * per) * height;
      z[i] = (m2 * px + m6 * py + m10 * pz + m14) * per;
    }
  }

  private paint(n: number, colour: THREE.Color): void {
    const { r, g, b } = this.raster;
    r.fill(shade(colour.r), 0, n);
    g.fill(shade(colour.g), 0, n);
    b.fill(shade(colour.b), 0, n);
  }

  /** Lambert's law: a sun, and a sky that is brighter than the ground. */
  private illuminate(normals: THREE.TypedArray, colours: THREE.TypedArray | undefined, n: number, world: THREE.Matrix4, colour: THREE.Color): void {
    const { r, g, b } = this.raster;
    const { sun, sunLight, above, below } = this;
    const m = world.elements;
    // A normal goes with the inverse of each axis' stretch.
    const [s0, s1, s2] = [0, 4, 8].map((k) => 1 / (m[k]! ** 2 + m[k + 1]! ** 2 + m[k + 2]! ** 2)) as [number, number, number];
    const [m0, m1, m2, m4, m5, m6, m8, m9, m10] = [m[0]! * s0, m[1]! * s0, m[2]! * s0, m[4]! * s1, m[5]! * s1, m[6]! * s1, m[8]! * s2, m[9]! * s2, m[10]! * s2];
    let [cr, cg, cb] = [colour.r, colour.g, colour.b];
    for (let i = 0, k = 0; i < n; i++, k += 3) {
      const [nx, ny, nz] = [normals[k]!, normals[k + 1]!, normals[k + 2]!];
      const [wx, wy, wz] = [m0 * nx + m4 * ny + m8 * nz, m1 * nx + m5 * ny + m9 * nz, m2 * nx + m6 * ny + m10 * nz];
      const per = 1 / (Math.sqrt(wx * wx + wy * wy + wz * wz) || 1);
      const direct = sunLight * Math.max((wx * sun.x + wy * sun.y + wz * sun.z) * per, 0);
      const up = 0.5 + 0.5 * wy * per; // a sky light of three.js is along y
      if (colours) [cr, cg, cb] = [colours[k]!, colours[k + 1]!, colours[k + 2]!];
      r[i] = shade(cr * (direct + below.r + (above.r - below.r) * up));
      g[i] = shade(cg * (direct + below.g + (above.g - below.g) * up));
      b[i] = shade(cb * (direct + below.b + (above.b - below.b) * up));
    }
  }

  /** Two corners, as a strip of two triangles. */
  private line(line: THREE.Line): void {
    const { raster } = this;
    this.project(line.geometry.getAttribute("position").array, 2, line.matrixWorld);
    const { x, y, z } = raster;
    const [dx, dy] = [x[1]! - x[0]!, y[1]! - y[0]!];
    const half = (0.5 * LINE_PX) / (Math.hypot(dx, dy) || 1);
    for (let i = 0; i < 2; i++) {
      [x[i + 2], y[i + 2], z[i + 2]] = [x[i]! + half * dy, y[i]! - half * dx, z[i]!];
      [x[i], y[i]] = [x[i]! - half * dy, y[i]! + half * dx];
    }
    this.paint(4, (line.material as THREE.LineBasicMaterial).color);
    raster.triangle(0, 1, 2, true);
    raster.triangle(1, 3, 2, true);
  }

  private letter(sprite: THREE.Sprite, camera: THREE.PerspectiveCamera): void {
    const { width, height } = this.raster;
    const at = this.at.setFromMatrixPosition(sprite.matrixWorld).applyMatrix4(this.seen);
    const picture = sprite.material.map?.image as HTMLCanvasElement | undefined;
    if (at.w <= 0 || !picture) return;
    const size = (sprite.scale.x * camera.projectionMatrix.elements[5]! * 0.5 * height) / at.w;
    this.context.drawImage(picture, (0.5 + (0.5 * at.x) / at.w) * width - size / 2, (0.5 - (0.5 * at.y) / at.w) * height - size / 2, size, size);
  }

  dispose(): void {
    this.domElement.width = this.domElement.height = 0;
  }
}
