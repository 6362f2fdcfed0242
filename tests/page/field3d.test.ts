// Arrows, and how finely they are drawn.

import { arrowGeometry, writeArrow } from "../../host/page/src/views/arrow";
import { Quality } from "../../host/page/src/views/quality";

const dot = (v: number[], w: number[]): number => v.reduce((sum, c, i) => sum + c * w[i]!, 0);
const cross = (v: number[], w: number[]): number[] => [0, 1, 2].map((i) => v[(i + 1) % 3]! * w[(i + 2) % 3]! - v[(i + 2) % 3]! * w[(i + 1) % 3]!);

test("an arrow ends where the force acts, along it, as long as it is large", () => {
  for (const force of [[0, 0, -2], [0, 0, 3], [1, 0, 0], [0, -1, 0], [1, -2, -3], [0.01, 0, -1]]) {
    const [fx, fy, fz] = force as [number, number, number];
    const out = new Array<number>(20).fill(NaN);
    writeArrow(out, 4, { x: 4, y: 5, z: 6 }, fx, fy, fz, 0.5, 0.1, 0.8);
    const [across, other, along, end] = [4, 8, 12, 16].map((at) => out.slice(at, at + 3)) as [number[], number[], number[], number[]];
    expect([7, 11, 15, 19].map((at) => out[at])).toEqual([0, 0, 0, 1]);
    expect(end).toEqual([4, 5, 6]);
    force.forEach((f, i) => expect(along[i]).toBeCloseTo(-0.5 * f, 12));
    expect(Math.hypot(...across)).toBeCloseTo(0.08, 12);
    expect(Math.hypot(...other)).toBeCloseTo(0.08, 12);
    for (const [v, w] of [[across, other], [other, along], [along, across]] as const) expect(dot(v, w)).toBeCloseTo(0, 12);
    expect(dot(cross(across, other), along)).toBeGreaterThan(0); // not inside out
  }
});

test("the shape of an arrow is of length 1 and comes from +z", () => {
  const geometry = arrowGeometry();
  geometry.computeBoundingBox();
  expect(geometry.boundingBox!.min.z).toBeCloseTo(0, 12);
  expect(geometry.boundingBox!.max.z).toBeCloseTo(1, 12);
});

function draw(quality: Quality, nPictures: number, costOf: (ratio: number) => number): number[] {
  return Array.from({ length: nPictures }, () => {
    quality.note(costOf(quality.ratio));
    return quality.ratio;
  });
}

test("a picture that takes too long becomes coarser, until it does not", () => {
  const quality = new Quality(2, 1, 10, 4);
  const seen = draw(quality, 100, (ratio) => 16 * ratio * ratio);
  expect(seen.at(-1)).toBe(0.75); // 9 ms; 1 is 16
  draw(quality, 200, () => 1000);
  expect(quality.ratio).toBe(0.5); // and no coarser
});

test("a quick one becomes finer, and a pause for something else changes nothing", () => {
  const quality = new Quality(2, 1, 10, 4);
  let i = 0;
  expect(draw(quality, 400, () => (++i % 5 === 0 ? 500 : 1)).at(-1)).toBe(2);
  expect(new Quality(1.25, 1.25, 10, 4).ratio).toBe(1.25); // the screen's own
});

test("what proved too fine is tried seldomer each time", () => {
  const quality = new Quality(2, 1, 10, 4);
  const seen = draw(quality, 5000, (ratio) => (ratio > 1 ? 20 : 2));
  const nTried = seen.filter((ratio, at) => ratio > 1 && seen[at - 1]! <= 1).length;
  expect(nTried).toBeGreaterThan(3);
  expect(nTried).toBeLessThan(8); // after 60, 120, 240 ... quick ones
  expect(seen.filter((ratio) => ratio > 1).length).toBeLessThan(0.05 * seen.length);
});
