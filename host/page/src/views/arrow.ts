// An arrow as a force on a surface: it ends where the force acts, and is as long as the force is large.

import * as THREE from "three";

const N_SIDES = 6;

/** An arrow of length 1 that ends in the origin and comes from +z. */
export function arrowGeometry(): THREE.BufferGeometry {
  // radius over height, from the tip up: a head of a third, then the shaft
  const outline = [[0, 0], [0.13, 0.36], [0.05, 0.36], [0.05, 1], [0, 1]].map(([r, h]) => new THREE.Vector2(r, h));
  return new THREE.LatheGeometry(outline, N_SIDES).rotateX(Math.PI / 2);
}

/**
 * The matrix, columns one after another in out[at ...], of an arrow that ends at `place` along the force (fx, fy, fz),
 * which is not zero; as long as lengthPerN says, as wide as it is long times `fat`, and no wider than `fat` times `widest`.
 */
export function writeArrow(
  out: Float32Array | number[], at: number, place: { x: number; y: number; z: number }, fx: number, fy: number, fz: number, lengthPerN: number, widest: number, fat: number,
): void {
  const force = Math.sqrt(fx * fx + fy * fy + fz * fz);
  const length = Math.max(force * lengthPerN, 1e-9);
  const width = fat * Math.min(length, widest);
  // Against the force; then any two directions across: an arrow is round.
  const [dx, dy, dz] = [-fx / force, -fy / force, -fz / force];
  const isUp = Math.abs(dz) > 0.9;
  const [ax, ay, az] = isUp ? [0, dz, -dy] : [dy, -dx, 0]; // d x X, or d x Z
  const per = 1 / Math.sqrt(ax * ax + ay * ay + az * az);
  const [ux, uy, uz] = [ax * per, ay * per, az * per];
  out[at] = ux * width;
  out[at + 1] = uy * width;
  out[at + 2] = uz * width;
  out[at + 3] = 0;
  out[at + 4] = (dy * uz - dz * uy) * width;
  out[at + 5] = (dz * ux - dx * uz) * width;
  out[at + 6] = (dx * uy - dy * ux) * width;
  out[at + 7] = 0;
  out[at + 8] = dx * length;
  out[at + 9] = dy * length;
  out[at + 10] = dz * length;
  out[at + 11] = 0;
  out[at + 12] = place.x;
  out[at + 13] = place.y;
  out[at + 14] = place.z;
  out[at + 15] = 1;
}
