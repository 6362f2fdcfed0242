// What is written at a person's pace: not more often than that, and the newest always.

import { Paced } from "../../host/page/src/views/paced";

function counted(everyMs: number): { paced: Paced; times: number[]; tick: (ms: number) => void } {
  const times: number[] = [];
  let now = 0;
  const paced = new Paced(everyMs, () => times.push(now));
  return { paced, times, tick: (ms) => paced.tick((now = ms)) };
}

test("the first is done at once, later ones not before their time, the last one always", () => {
  const { paced, times, tick } = counted(100);
  for (let ms = 0; ms <= 250; ms += 10) {
    paced.ask();
    tick(ms);
  }
  expect(times).toEqual([0, 100, 200]);
  for (let ms = 260; ms <= 1000; ms += 10) tick(ms);
  expect(times).toEqual([0, 100, 200, 300]);
});

test("nothing is done where nothing is new, and what cannot wait does not", () => {
  const { paced, times, tick } = counted(100);
  tick(0);
  expect(times).toEqual([]);
  paced.ask();
  paced.flush();
  expect(times).toEqual([0]);
  tick(200);
  expect(times).toEqual([0]);
});
