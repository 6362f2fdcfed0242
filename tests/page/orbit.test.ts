// Keys move the camera about what is looked at.

import { orbit, type Place } from "../../host/page/src/views/orbit";

const FROM: Place = [1, -2, 3];
const off = (a: Place, b: Place): number => Math.hypot(...a.map((c, i) => c - b[i]!));
const times = (n: number, key: string, from: Place): Place => Array.from({ length: n }).reduce<Place>((at) => orbit(at, key)!, from);

test.each([["ArrowLeft", "ArrowRight"], ["ArrowUp", "ArrowDown"], ["+", "-"]])("%s moves, and %s takes it back", (one, other) => {
  const moved = orbit(FROM, one)!;
  expect(off(moved, FROM)).toBeGreaterThan(0.1);
  expect(off(orbit(moved, other)!, FROM)).toBeLessThan(1e-9);
});

test("a whole turn keeps the distance, and it never goes over the pole", () => {
  expect(off(times(48, "ArrowLeft", FROM), FROM)).toBeLessThan(1e-9);
  const top = times(100, "ArrowUp", FROM);
  expect(Math.hypot(...top)).toBeCloseTo(Math.hypot(...FROM), 9);
  expect(top[2]).toBeLessThan(Math.hypot(...FROM));
  expect(top[2]).toBeGreaterThan(0.99 * Math.hypot(...FROM));
  expect(orbit(FROM, "x")).toBeUndefined();
});
