// Triangles into memory: each pixel once, the nearest wins, nothing beyond the picture.

import { Raster } from "../../host/page/src/views/raster";

const [W, H] = [20, 16];
const BLACK = 0xff000000;

function raster(): Raster {
  const out = new Raster();
  out.resize(W, H, new Uint32Array(W * H));
  out.clear(BLACK);
  return out;
}

function corner(to: Raster, i: number, x: number, y: number, z = 0, red = 200): void {
  [to.x[i], to.y[i], to.z[i], to.r[i], to.g[i], to.b[i]] = [x, y, z, red, 0, 0];
}

const red = (of: Raster, x: number, y: number): number => of.pixels[y * W + x]! & 255;
const nPainted = (of: Raster): number => of.pixels.filter((p) => p !== BLACK).length;

test("two triangles of a square paint each of its pixels once", () => {
  const r = raster();
  [[2, 3], [12, 3], [12, 10], [2, 10]].forEach(([x, y], i) => corner(r, i, x!, y!, 0, 100));
  r.triangle(0, 1, 2, true, 0.5);
  r.triangle(0, 2, 3, true, 0.5);
  expect(nPainted(r)).toBe(70);
  for (let y = 3; y < 10; y++) for (let x = 2; x < 12; x++) expect(red(r, x, y)).toBe(50); // twice would be 75
});

test("a triangle of the golden kind: pixels whose centres are inside", () => {
  const r = raster();
  corner(r, 0, 0, 0);
  corner(r, 1, 0, 4);
  corner(r, 2, 4, 0);
  r.triangle(0, 1, 2, false);
  expect(nPainted(r)).toBe(6); // x + y < 3; the centres on the slanted edge are its right side's
});

test("the nearer one wins, whichever is drawn first", () => {
  for (const order of [[0, 3], [3, 0]]) {
    const r = raster();
    for (const [at, z, value] of [[0, 0.5, 40], [3, -0.5, 90]] as const) {
      corner(r, at, 0, 0, z, value);
      corner(r, at + 1, 0, 16, z, value);
      corner(r, at + 2, 20, 0, z, value);
    }
    for (const at of order) r.triangle(at, at + 1, at + 2, false);
    expect(red(r, 2, 2)).toBe(90);
  }
});

test("what is drawn over all hides, and is hidden by, nothing", () => {
  const r = raster();
  for (const [at, z, value] of [[0, -0.5, 40], [3, 0.5, 90]] as const) {
    corner(r, at, 0, 0, z, value);
    corner(r, at + 1, 0, 16, z, value);
    corner(r, at + 2, 20, 0, z, value);
  }
  r.triangle(0, 1, 2, false);
  r.triangle(3, 4, 5, false, 1, true);
  expect(red(r, 2, 2)).toBe(90);
  r.z.fill(0);
  r.triangle(0, 1, 2, false);
  expect(red(r, 2, 2)).toBe(90); // the depth before is still there
});

test("a back is seen only of what has two sides, and colours run from corner to corner", () => {
  const r = raster();
  corner(r, 0, 0, 0, 0, 0);
  corner(r, 1, 20, 0, 0, 200);
  corner(r, 2, 0, 16, 0, 0);
  r.triangle(0, 1, 2, false);
  expect(nPainted(r)).toBe(0);
  r.triangle(0, 1, 2, true);
  expect([red(r, 0, 0), red(r, 9, 0), red(r, 18, 0)]).toEqual([5, 95, 185]); // 10 a pixel, at its centre
});

test("corners far outside, on one line or no number spoil nothing", () => {
  const r = raster();
  corner(r, 0, -1e7, -1e7);
  corner(r, 1, -1e7, 1e7);
  corner(r, 2, 1e7, 0);
  r.triangle(0, 1, 2, true);
  expect(nPainted(r)).toBe(W * H);
  r.clear(BLACK);
  for (const [x, y] of [[5, NaN], [Infinity, 5], [5, 5]] as const) {
    corner(r, 2, x, y);
    corner(r, 1, 5, 5);
    corner(r, 0, 5, 5);
    r.triangle(0, 1, 2, true);
  }
  expect(nPainted(r)).toBe(0);
});
