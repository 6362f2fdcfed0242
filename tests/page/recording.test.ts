// Recordings: what was recorded is what is played, and a file that is cut is played as far as it goes, one that is spoilt is refused with a sentence.

import { Recording } from "../../host/page/src/recording";
import { BadRecording, Replay } from "../../host/page/src/replay";
import { saidAs, SCHEMA } from "./device";
import { Decoder } from "../../host/page/src/wire/framing";
import { hexOf, randomNumbers } from "./golden";

const HELLO = SCHEMA.encode("Hello", { deviceSerial: "7", protocolVersion: 1 });
const PIECES = Array.from({ length: 8 }, (_, i) => saidAs("WRENCH", "Wrench", { forceZUn: BigInt(-i), stamp: { captureUs: BigInt(1000 * i) } }, i));

async function recorded(): Promise<Blob> {
  const recording = new Recording(SCHEMA, HELLO);
  PIECES.forEach((piece, i) => {
    recording.addMessage("WRENCH", i, piece.subarray(13), BigInt(1000 * i));
    recording.addRaw(piece);
  });
  expect(recording.nMessages).toBe(9);
  return recording.finish();
}

async function played(file: Blob): Promise<string[]> {
  const out: string[] = [];
  const replay = await Replay.open(file);
  await replay.play((data) => out.push(hexOf(data)), () => false);
  return out;
}

test("what was recorded is played, byte for byte, with its sensor and its schema", async () => {
  const file = await recorded();
  expect(await played(file)).toEqual(PIECES.map(hexOf));
  const replay = await Replay.open(file);
  expect(replay.hello["deviceSerial"]).toBe("7");
  expect(replay.schema.typeNumber("WRENCH")).toBe(4);
  expect(await replay.play(() => undefined, () => true)).toBe(false);
});

test("a file that is cut within its only chunk, or none, is refused with a sentence", async () => {
  const file = await recorded();
  const bytes = Buffer.from(await file.arrayBuffer());
  const chunkEnd = bytes.lastIndexOf(PIECES.at(-1)!) + PIECES.at(-1)!.length;
  for (let cut = 0; cut < chunkEnd; cut += 97) await expect(played(file.slice(0, cut))).rejects.toThrow(BadRecording);
  for (const other of [new Blob(["not an MCAP at all"]), new Blob([new Uint8Array(5000)])]) {
    await expect(Replay.open(other)).rejects.toThrow(/no MCAP file/);
  }
});

test("a file that is cut later is played up to there, and says that it is cut", async () => {
  const recording = new Recording(SCHEMA, HELLO);
  const pieces = Array.from({ length: 24 }, (_, i) => new Uint8Array(200_000).fill(i + 1)); // several chunks
  for (const piece of pieces) recording.addRaw(piece);
  const file = await recording.finish();
  expect((await Replay.open(file)).isCut).toBe(false);
  const counts: number[] = [];
  for (const part of [0.3, 0.6, 0.9, 0.999]) {
    const cut = file.slice(0, Math.floor(file.size * part));
    const shown = await played(cut);
    expect(shown).toEqual(pieces.slice(0, shown.length).map(hexOf));
    expect((await Replay.open(cut)).isCut).toBe(true);
    counts.push(shown.length);
  }
  expect(counts[0]).toBeGreaterThan(0);
  expect(counts).toEqual([...counts].sort((a, b) => a - b));
  expect(counts.at(-1)).toBeGreaterThan(20);
});

test("of a spoilt file nothing is shown that was not recorded", async () => {
  const bytes = new Uint8Array(await (await recorded()).arrayBuffer());
  const next = randomNumbers(23);
  const decoded = (pieces: string[]): string[] => {
    const decoder = new Decoder();
    return pieces.flatMap((hex) => decoder.feed(Uint8Array.from(Buffer.from(hex, "hex")))).map((f) => hexOf(f.payload));
  };
  const good = decoded(PIECES.map(hexOf));
  let nRefused = 0;
  for (let round = 0; round < 300; round++) {
    const spoilt = bytes.slice();
    spoilt[next() % spoilt.length]! ^= 1 << (next() % 8);
    try {
      const shown = decoded(await played(new Blob([spoilt])));
      expect(shown.filter((payload) => !good.includes(payload))).toEqual([]);
    } catch (error) {
      expect(error).toBeInstanceOf(Error);
      nRefused++;
    }
  }
  expect(nRefused).toBeGreaterThan(250); // the chunk has a CRC; what is outside of it says nothing that is shown
});
