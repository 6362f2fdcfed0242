// Frames against the golden bytes of proto/vectors, and against hostile ones.

import { crc32c } from "../../host/page/src/wire/crc32c";
import { cobsDecode, cobsEncode, Decoder, encodeCommandFrame, type Frame } from "../../host/page/src/wire/framing";
import { said } from "./device";
import { bytesOf, hexOf, randomNumbers, readVectors } from "./golden";

const FRAMES = readVectors("frames.txt") as [string, string, string][];

function textOf(f: Frame): string {
  return (
    `frame type=${f.type} flags=${f.flags} sensor=${f.sensor} sequence=${f.sequence} ` +
    `fragment=0 fragments=1 payload=${hexOf(f.payload)}`
  );
}

test("there are enough vectors", () => {
  const good = FRAMES.filter(([, , outcome]) => outcome.startsWith("frame"));
  expect(good.length).toBeGreaterThanOrEqual(15);
  expect(FRAMES.length - good.length).toBeGreaterThanOrEqual(25);
});

test.each(FRAMES)("says of '%s' what the specification says", (_, hex, outcome) => {
  for (const step of [1, 7, 100_000]) {
    const decoder = new Decoder(outcome.includes("flags=1 "));
    const data = bytesOf(hex);
    const said: string[] = [];
    for (let at = 0; at < data.length; at += step) said.push(...decoder.feed(data.subarray(at, at + step)).map(textOf));
    const events = outcome.split("; ");
    // A fragment of several is no message yet.
    expect(said).toEqual(events.filter((e) => e.startsWith("frame") && e.includes("fragments=1 ")));
    for (const what of ["bad_crc", "malformed", "oversize"] as const) {
      expect(decoder.counters[what]).toBe(events.filter((e) => e === what).length);
    }
  }
});

test("a host's golden frames are encoded byte for byte", () => {
  const hosts = FRAMES.filter(([, , outcome]) => outcome.includes("flags=1 sensor=255"));
  expect(hosts.length).toBeGreaterThanOrEqual(5);
  for (const [, hex, outcome] of hosts) {
    const [, type, sequence, payload] = /type=(\d+) .* sequence=(\d+) .*payload=(\w*)$/.exec(outcome)!;
    expect(hexOf(encodeCommandFrame(Number(type), bytesOf(payload!), Number(sequence)))).toBe(hex);
  }
  expect(() => encodeCommandFrame(11, new Uint8Array(4049), 0)).toThrow(RangeError);
});

test("the CRC is Castagnoli's", () => {
  expect(crc32c(new TextEncoder().encode("123456789"))).toBe(0xe3069283);
});

test("COBS comes back as it was, whatever the length and the zeros", () => {
  const next = randomNumbers(1);
  const out = new Uint8Array(4096);
  for (let i = 0; i < 300; i++) {
    const data = Uint8Array.from({ length: i * 3 }, () => (next() % (1 + (i % 7)) ? next() & 255 : 0));
    const encoded = cobsEncode(data);
    expect(encoded.includes(0)).toBe(false);
    expect(hexOf(out.slice(0, cobsDecode(encoded, out)))).toBe(hexOf(data));
  }
});

test("a message of several fragments is put together, and none of it where one is missing", () => {
  const parts = FRAMES.filter(([name]) => name.endsWith("of two fragments")).map(([, hex]) => bytesOf(hex));
  const [first, second] = parts as [Uint8Array, Uint8Array];
  const decoder = new Decoder();
  expect(decoder.feed(first)).toEqual([]);
  expect(hexOf(decoder.feed(second)[0]!.payload)).toBe("61626364");
  expect(decoder.feed(second)).toEqual([]);
  expect(decoder.counters.incomplete).toBe(0);
  decoder.feed(first);
  expect(decoder.feed(first)).toEqual([]);
  expect(decoder.counters.incomplete).toBe(1);
});

test("hostile bytes: broken, cut, swapped and random streams never throw, and every message is one that was sent", () => {
  const next = randomNumbers(2);
  const whole = FRAMES.filter(([, , outcome]) => outcome.startsWith("frame") && outcome.includes("flags=0"));
  const sent = new Set(whole.flatMap(([, , outcome]) => outcome.split("; ").map((e) => e.split("payload=")[1])));
  const decoder = new Decoder();
  let nMessages = 0;
  for (let round = 0; round < 20_000; round++) {
    const data = bytesOf(whole[next() % whole.length]![1]).slice();
    const kind = next() % 4;
    if (kind === 0) data[next() % data.length] = next() & 255;
    const cut = kind === 1 ? data.subarray(next() % data.length) : data;
    const noise = kind === 2 ? Uint8Array.from({ length: next() % 64 }, () => next() & 255) : new Uint8Array();
    for (const message of [...decoder.feed(noise), ...decoder.feed(cut)]) {
      nMessages++;
      if (message.payload.length < 4048) expect(sent.has(hexOf(message.payload)) || hexOf(message.payload) === "61626364").toBe(true);
    }
  }
  expect(nMessages).toBeGreaterThan(1000);
  expect(decoder.counters.bad_crc + decoder.counters.malformed).toBeGreaterThan(1000);
});

test("an endless frame holds no more memory than one frame", () => {
  const decoder = new Decoder();
  for (let i = 0; i < 1000; i++) expect(decoder.feed(new Uint8Array(65_536).fill(2))).toEqual([]);
  expect(decoder.counters.oversize).toBe(1);
});

test("fragments of two messages, or in another order, are no message", () => {
  const fragments = (sequence: number): Uint8Array[] => {
    const data = said("IMAGE", new Uint8Array(9_000).fill(1), sequence);
    return [...data.join(",").split(/(?<=,|^)0(?=,|$)/)].slice(0, 3).map((part) => {
      return Uint8Array.from([...part.split(",").filter((byte) => byte !== "").map(Number), 0]);
    });
  };
  const [first, second, third] = fragments(1) as [Uint8Array, Uint8Array, Uint8Array];
  const fed = (...parts: Uint8Array[]): number => {
    const decoder = new Decoder();
    return parts.flatMap((part) => decoder.feed(part)).length;
  };
  expect(fed(first, second, third)).toBe(1);
  expect(fed(first, third, second)).toBe(0);
  expect(fed(first, second, fragments(2)[2]!)).toBe(0);
});

test("lost messages are counted, a restart is none, and an echo of a command is counted", () => {
  const decoder = new Decoder();
  for (const sequence of [70_000, 0, 1, 3]) decoder.feed(said("WRENCH", new Uint8Array(), sequence));
  expect(decoder.counters.lost).toBe(1);
  expect(decoder.feed(encodeCommandFrame(11, new Uint8Array(), 9))).toEqual([]);
  expect(decoder.counters.echo).toBe(1);
});
