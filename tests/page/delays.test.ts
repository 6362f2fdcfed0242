// The histogram of delays: clocks that drift, delays that change.

import { Delays, WINDOW_MS } from "../../host/page/src/delays";

const PERIOD_MS = 1000 / 60;

/** Bins after an hour of frames, the sensor's clock off by so many parts in a million. */
function after(ppm: number, delayMs: (i: number) => number): number[] {
  const delays = new Delays();
  const n = 3600 * 60;
  let now = 0;
  for (let i = 0; i < n; i++) {
    const taken = i * PERIOD_MS;
    now = taken + delayMs(i);
    delays.add(now, 5e6 + taken * (1 + ppm * 1e-6));
  }
  return delays.bins(now);
}

test.each([-100, -20, 0, 20, 100])("clocks that differ by %d ppm delay no frame", (ppm) => {
  const bins = after(ppm, () => 12);
  expect(bins[0]).toBeGreaterThan(WINDOW_MS / PERIOD_MS - 2);
  expect(bins.slice(1).every((n) => n === 0)).toBe(true);
});

test("frames that come late are seen, and forgotten with the window", () => {
  const late = after(20, (i) => (i % 10 ? 5 : 17));
  const n = late.reduce((a, b) => a + b, 0);
  expect(late[5]! + late[6]!).toBe(Math.round(n / 10)); // 12 ms later, bins of 2 ms
  expect(after(20, (i) => (i < 1000 ? 40 : 5)).slice(1).every((k) => k === 0)).toBe(true);
});
