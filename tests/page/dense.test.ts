// Node values against the golden bytes of proto/vectors, and against hostile ones.

import { BadData, decodeDense } from "../../host/page/src/wire/dense";
import { packed } from "./device";
import { bytesOf, randomNumbers, readVectors } from "./golden";

const CASES = readVectors("dense.txt") as [string, string, string, string, string, string][];

test.each(CASES)("decodes '%s' as the specification says", (_, codec, nodes, components, hex, values) => {
  const message = { codec: Number(codec), nX: Number(nodes), nY: 1, nComponents: Number(components), data: bytesOf(hex) };
  if (values === "error") expect(() => decodeDense(message)).toThrow(BadData);
  else expect([...decodeDense(message)].join(",")).toBe(values);
});

test("hostile data is refused or decoded, never anything else", () => {
  const next = randomNumbers(3);
  const good = CASES.filter((c) => c[5] !== "error");
  let nRefused = 0;
  for (let round = 0; round < 20_000; round++) {
    const [, codec, nodes, components, hex] = good[next() % good.length]!;
    const data = bytesOf(hex).slice();
    for (let i = next() % 3; i > 0; i--) data[next() % data.length] = next() & 255;
    const sizes = { nX: Number(nodes), nY: next() % 8 ? 1 : next() % 5000, nComponents: Number(components) };
    try {
      const cut = data.subarray(0, next() % 4 ? data.length : next() % data.length);
      const values = decodeDense({ codec: next() % 9 ? Number(codec) : next(), ...sizes, data: cut });
      expect(values.length).toBe(sizes.nX * sizes.nY * sizes.nComponents);
    } catch (error) {
      expect(error).toBeInstanceOf(BadData);
      nRefused++;
    }
  }
  expect(nRefused).toBeGreaterThan(2000);
  expect(nRefused).toBeLessThan(19_000);
});

test("sizes from the wire reserve nothing that the data does not fill", () => {
  const data = new Uint8Array(8);
  for (const [nX, nY] of [[65_535, 64], [4_194_304, 1], [2 ** 32 - 1, 2 ** 32 - 1], [1e308, 1e308]] as const) {
    expect(() => decodeDense({ codec: 0, nX, nY, nComponents: 1, data })).toThrow(BadData);
    expect(() => decodeDense({ codec: 1, nX, nY, nComponents: 1, data })).toThrow(BadData);
  }
});

test("values of any width are whole where they lie in five bytes", () => {
  for (const width of [25, 26, 27, 28, 29, 30, 31]) {
    const values = Array.from({ length: 32 }, (_, i) => (i % 2 ? -1 : 1) * (2 ** (width - 1) - 1 - i));
    const message = { codec: 0, nX: 32, nY: 1, nComponents: 1, data: packed(values) };
    expect([...decodeDense(message)]).toEqual(values);
  }
});
