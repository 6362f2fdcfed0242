// Each field of each result in ruffini.proto changes what the page has of it, or is left out for a reason; and recordings of the
// version whose contacts had the numbers of all stages.

import { readFileSync } from "node:fs";
import { Replay } from "../../host/page/src/replay";
import { type Contact, contactsOf, depthOf, fieldOf, learnedOf, residualOf, wrenchOf } from "../../host/page/src/results";
import { Decoder } from "../../host/page/src/wire/framing";
import type { Decoded } from "../../host/page/src/wire/schema";
import { dense, SCHEMA } from "./device";

type Fields = Record<string, any>; // eslint-disable-line @typescript-eslint/no-explicit-any

const STAMP = { captureUs: 7_000_000n, frame: 420n, flags: 1024 };
const NODES = dense(2, 1, 3, [1, 2, 3, 4, 5, 6]);
const ONE = dense(2, 1, 1, [1, 2]);
const SLIP = { slipState: 2, shearRatio1e3: 350, friction1e3: 500, frictionSigma1e3: 100, slipShare1e3: 620, slipMarginUn: 25_000n };
const SKIN = { placeUm: [1, 2, 3], normalForceUn: [4n, 5n, 6n], forceSigmaUn: 7n, centerSigmaUm: 8 };
const TOOL = {
  toolUm: [11, 12, 13],
  turnUrad: [14, 15],
  normalForceUn: [16n, 17n, 18n],
  toolSigma: [21, 22, 23, 24, 25, 26, 27],
  flatAreaUm2K: 28,
  flatAreaSigmaUm2K: 29,
};
const MODEL = {
  depthValidity: 1,
  kind: 2,
  kindSure1e3: 870,
  gelDepthUm: 31,
  pressDepthUm: 32,
  depthSigmaUm: 33,
  effectiveAreaUm2K: 34,
  stiffnessPaUm: -35,
  shoreA1e1: 360,
  shoreASigma1e1: 37,
  hardnessValidity: 1,
  meanFlowUm: 38,
  momentByFlowUnmm: 39n,
};
const SOFTNESS = { validity: 1, squeeze: 3, nFrames: 12, modulusPa: 60_000, lowPa: 40_000, highPa: 90_000, logShareQ16: -70_000, logSigmaQ16: 9_000 };
const CONTACT = {
  id: 3,
  areaUm2K: 5000,
  centerXUm: 100,
  centerYUm: -200,
  forceXUn: 30n,
  forceYUn: 40n,
  forceZUn: -3000n,
  peakDepthNm: -50_000,
  validity: 1,
  reachesBorder: true,
  forceValidity: [1, 1, 1],
  helmholtz: { curlFreeNm: 41, divergenceFreeNm: 42, twistUrad: -43 },
  slip: SLIP,
  skin: SKIN,
  tool: TOOL,
  model: MODEL,
};

const RESULTS: Record<string, [(m: Decoded) => unknown, Fields]> = {
  Wrench: [
    wrenchOf,
    {
      stamp: STAMP,
      forceXUn: 1n,
      forceYUn: 2n,
      forceZUn: 3n,
      torqueXUnUm: 4n,
      torqueYUnUm: 5n,
      torqueZUnUm: 6n,
      validity: [1, 1, 1, 1, 1, 1],
      covariance: Array.from({ length: 21 }, (_, i) => BigInt(i + 1)),
      covarianceValidity: 1,
    },
  ],
  Field: [
    fieldOf,
    { forceLsbUn: 10, force: NODES, displacementLsbNm: 100, displacement: NODES, validity: [1, 1, 1], slip: ONE, sigma: NODES, sigmaValidity: 1 },
  ],
  Residual: [residualOf, { residualLsb1e6: 15_625, residual: NODES, validity: 1 }],
  Depth: [depthOf, { depthLsbNm: 1000, stepPx: 2, depth: ONE, validity: 1, sigmaUm: 9 }],
  Contacts: [contactsOf, { contacts: [CONTACT], nFound: 9, softness: SOFTNESS }],
  Learned: [learnedOf, { validity: 1, quantities: [{ name: "force_un", value: -5n }], tookUs: 10, latencyUs: 20, periodUs: 30_000 }],
};
// MARKERS: the page shows where they are in the picture. IMAGE: the picture itself (results.test.ts).

function wordsOf(name: string, fields: Fields): string {
  const [read] = RESULTS[name]!;
  const message = SCHEMA.decode(SCHEMA.typeNumber(name.toUpperCase())!, SCHEMA.encode(name, fields))!;
  return JSON.stringify(read(message), (_, v) => (typeof v === "number" && Number.isNaN(v) ? "NaN" : ArrayBuffer.isView(v) ? Array.from(v as Float32Array) : v));
}

/** The fields with one of them changed, each in turn; Dense counts as one. */
function* changed(fields: Fields, path = ""): Generator<[string, Fields]> {
  for (const [name, value] of Object.entries(fields)) {
    const at = path + name;
    const put = (v: unknown): [string, Fields] => [at, { ...fields, [name]: v }];
    if (typeof value === "boolean") yield put(!value);
    else if (typeof value === "bigint") yield put(value + 1n);
    else if (typeof value === "number") yield put(/alidity/.test(name) ? 3 : value + 1);
    else if (typeof value === "string") yield put(`${value}x`);
    else if (value === NODES) yield put(dense(2, 1, 3, [9, 2, 3, 4, 5, 6]));
    else if (value === ONE) yield put(dense(2, 1, 1, [9, 2]));
    else if (Array.isArray(value) && typeof value[0] === "object") for (const [inner, one] of changed(value[0], `${at}.`)) yield [inner, { ...fields, [name]: [one] }];
    else if (Array.isArray(value)) yield put([/alidity/.test(name) ? 0 : value[0] + (typeof value[0] === "bigint" ? 1n : 1), ...value.slice(1)]);
    else for (const [inner, one] of changed(value, `${at}.`)) yield [inner, { ...fields, [name]: one }];
  }
}

test.each(Object.keys(RESULTS))("every field of a %s is carried", (name) => {
  const [, fields] = RESULTS[name]!;
  const before = wordsOf(name, fields);
  const lost = [...changed(fields)].filter(([, other]) => wordsOf(name, other) === before).map(([path]) => path);
  expect(lost).toEqual([]);
});

async function contactsIn(file: string): Promise<Contact[]> {
  const replay = await Replay.open(new Blob([readFileSync(new URL(`../data/recordings/${file}.mcap`, import.meta.url))]));
  const decoder = new Decoder();
  const found: Contact[] = [];
  await replay.play(
    (data) => {
      for (const frame of decoder.feed(data)) {
        if (replay.schema.typeName(frame.type) === "CONTACTS") found.push(...contactsOf(replay.schema.decode(frame.type, frame.payload)!).contacts);
      }
    },
    () => false,
  );
  return found;
}

test("recordings of the version before have all their results", async () => {
  const skin = (await contactsIn("skin")).at(-1)!;
  skin.skin!.placeM.forEach((v, i) => expect(v).toBeCloseTo([-15297, -36959, 12929][i]! * 1e-6, 9));
  expect(skin.skin!.centerSigmaM).toBeCloseTo(1472e-6, 9);
  const tip = (await contactsIn("fingertip")).at(-1)!;
  tip.tool!.placeM.forEach((v, i) => expect(v).toBeCloseTo([3221, 2320, 540][i]! * 1e-6, 9));
  expect(tip.tool!.flatAreaM2).toBeCloseTo(49_293e-9, 12);
  const texture = (await contactsIn("texture")).at(-1)!;
  expect(texture.model).toMatchObject({ kind: 2, depthValidity: 1, hardnessValidity: 1 });
  expect(texture.model!.shoreA).toBeCloseTo(36, 9);
  expect(texture.flowParts!.twistRad).toBeCloseTo(-286e-6, 9);
  expect([texture.skin, texture.tool, skin.tool, skin.model, tip.skin]).toEqual([undefined, undefined, undefined, undefined, undefined]);
});
