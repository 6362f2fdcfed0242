// Numbers in SI units: the golden messages, what is not measured, parts that do not fit.

import { Model } from "../../host/page/src/model";
import { contactsOf, depthOf, fieldOf, imageOf, INVALID, NOT_MEASURED, residualOf, VALID, wrenchOf } from "../../host/page/src/results";
import { BadData } from "../../host/page/src/wire/dense";
import { Decoder } from "../../host/page/src/wire/framing";
import type { Decoded } from "../../host/page/src/wire/schema";
import { dense, said, SCHEMA } from "./device";
import { bytesOf, randomNumbers, readVectors } from "./golden";

function golden(name: string): Decoded {
  const [frame] = new Decoder().feed(bytesOf(readVectors("frames.txt").find(([n]) => n === name)![1]!));
  return SCHEMA.decode(frame!.type, frame!.payload)!;
}

function message(name: string, fields: Record<string, unknown>): Decoded {
  return SCHEMA.decode(SCHEMA.typeNumber(name.toUpperCase())!, SCHEMA.encode(name, fields))!;
}

test("a wrench and how sure it is", () => {
  const wrench = wrenchOf(golden("wrench and how sure it is"));
  expect(wrench.values).toEqual([0, 0, -1e-3, 0, 0, 0]);
  const deviations = [4, 4, 49, 64 + 196, 64, 9 + 16].map((v, i) => Math.sqrt(v) * (i < 3 ? 1e-6 : 1e-9));
  wrench.sigma!.forEach((s, i) => expect(s).toBeCloseTo(deviations[i]!, 15));
});

test("a field and how sure it is", () => {
  const field = fieldOf(golden("field and how sure it is"));
  expect([field.nX, field.nY]).toEqual([2, 1]);
  const [force, sigma] = [[200e-6, -100e-6, -3000e-6, 0, 0, 0], [70e-6, 70e-6, 250e-6, 10e-6, 10e-6, 90e-6]];
  field.force.forEach((f, i) => expect(f).toBeCloseTo(force[i]!, 9));
  field.sigma!.forEach((s, i) => expect(s).toBeCloseTo(sigma[i]!, 9));
  expect(field.displacement).toBeUndefined();
  expect(field.slip).toBeUndefined();
});

test("what the forces do not explain", () => {
  const residual = residualOf(golden("what the forces do not explain"));
  expect([residual.nX, residual.nY, residual.validity]).toEqual([2, 1, VALID]);
  [1.25, 68.0625].forEach((sum, i) => expect(residual.size[i]).toBeCloseTo(Math.sqrt(sum / 3), 5));
  expect(residualOf(message("Residual", { validity: 1 }))).toMatchObject({ nX: 0, validity: NOT_MEASURED }); // none is not zero
  expect(residualOf(message("Residual", { validity: 9, residual: dense(1, 1, 3, [1, 2, 3]) })).validity).toBe(INVALID);
  expect(residualOf(message("Residual", { validity: 1, residual: dense(1, 1, 1, [1]) })).nX).toBe(0);
  expect(() => residualOf(message("Residual", { residual: { ...dense(2, 1, 3, [1, 2, 3, 4, 5, 6]), data: bytesOf("04") } }))).toThrow(BadData);
});

test("a contact that begins to slip", () => {
  const [contact] = contactsOf(golden("contact that begins to slip")).contacts;
  expect(contact).toMatchObject({ slipState: 2, validity: 0 });
  expect(contact!.shearRatio).toBeCloseTo(0.35, 9);
  expect(contact!.friction).toBeCloseTo(0.5, 9);
  expect(contact!.slipMarginN).toBeCloseTo(0.025, 9);
  expect(contact!.force.every(Number.isNaN)).toBe(true); // not measured is not zero
  expect(contact!.areaM2).toBeNaN();
  expect(contact!.model).toBeUndefined();
});

test("a contact with all that stages add", () => {
  const [contact] = contactsOf(golden("contact with all that stages add")).contacts;
  const near = (got: number[], expected: number[]): void => got.forEach((v, i) => expect(v).toBeCloseTo(expected[i]!, 12));
  near(contact!.skin!.placeM, [1e-6, -2e-6, 3e-6]);
  near([contact!.skin!.forceSigmaN, contact!.skin!.centerSigmaM], [7e-6, 8e-6]);
  near(contact!.tool!.placeSigmaM, [22e-6, 23e-6, 24e-6]);
  near([contact!.tool!.pitchRad, contact!.tool!.faceAreaSigmaM2, contact!.tool!.flatAreaM2], [-15e-6, 27e-9, 28e-9]);
  near([contact!.model!.gelDepthM, contact!.model!.pressDepthM, contact!.model!.shoreA], [31e-6, 32e-6, 36]);
  expect(contact).toMatchObject({ reachesBorder: true, slipState: 0, model: { kind: 2, depthValidity: VALID } });
  near([contact!.flowParts!.curlFreeM, contact!.flowParts!.twistRad], [41e-9, -43e-6]);
});

test("parts of a contact that is not valid have no number", () => {
  const skin = { placeUm: [1, 2, 3], normalForceUn: [4n, 5n, 6n], forceSigmaUn: 7n };
  const [contact] = contactsOf(message("Contacts", { contacts: [{ validity: INVALID, skin, model: { depthValidity: INVALID, gelDepthUm: 5 } }] })).contacts;
  expect([...contact!.skin!.placeM, ...contact!.skin!.normalForceN, contact!.skin!.forceSigmaN, contact!.model!.gelDepthM].every(Number.isNaN)).toBe(true);
});

test("what is not measured, and what this page does not know, is never a valid number", () => {
  const wrench = wrenchOf(message("Wrench", { forceZUn: -5n, validity: [0, 1, 7] }));
  expect(wrench.values[0]).toBeNaN();
  expect(wrench.validity).toEqual([NOT_MEASURED, 1, INVALID, NOT_MEASURED, NOT_MEASURED, NOT_MEASURED]);
  expect(wrench.values.slice(3).every(Number.isNaN)).toBe(true);
  expect(wrench.sigma).toBeUndefined();
});

test("64-bit numbers are read exactly", () => {
  const wrench = wrenchOf(message("Wrench", { torqueXUnUm: -(2n ** 52n), validity: [1, 1, 1, 1, 1, 1], stamp: { frame: 2n ** 40n } }));
  expect(wrench.values[3]).toBe(-(2 ** 52) * 1e-12);
  expect(wrench.frame).toBe(2 ** 40);
});

test("parts of another size than the forces are left out, data that is cut is refused", () => {
  const force = dense(2, 1, 3, [1, 2, 3, 4, 5, 6]);
  const field = fieldOf(message("Field", { forceLsbUn: 10, force, slip: dense(3, 1, 1, [1, 2, 0]), displacement: dense(2, 1, 2, [1, 1, 1, 1]) }));
  expect(field.slip).toBeUndefined();
  expect(field.displacement).toBeUndefined();
  expect(fieldOf(message("Field", { force: dense(2, 1, 2, [1, 2, 3, 4]) })).nX).toBe(0);
  expect(() => fieldOf(message("Field", { force: { ...force, data: bytesOf("04") } }))).toThrow(BadData);
  expect(() => depthOf(message("Depth", { depth: { ...dense(1, 1, 1, [5]), nX: 4_000_000 } }))).toThrow(BadData);
});

test("pictures are B G R or grey, and exactly as large as they say", () => {
  const image = imageOf(message("Image", { format: 1, widthPx: 1, heightPx: 1, data: Uint8Array.from([1, 2, 3]) }));
  expect([...image!.rgba]).toEqual([3, 2, 1, 255]);
  expect([...imageOf(message("Image", { format: 0, widthPx: 1, heightPx: 1, data: Uint8Array.from([9]) }))!.rgba]).toEqual([9, 9, 9, 255]);
  expect(imageOf(message("Image", { format: 1, widthPx: 2 ** 31, heightPx: 2 ** 31, data: Uint8Array.from([1]) }))).toBeUndefined();
});

test("names of flags come from the schema, unknown ones as their number", () => {
  expect(SCHEMA.bits("FlagBit", 1 | 256)).toEqual(["NO_REFERENCE", "STALE"]);
  expect(SCHEMA.bits("FlagBit", 2 ** 31)).toEqual(["UNKNOWN_2147483648"]);
  expect(SCHEMA.enumName("ContactKind", 1)).toBe("PLANAR");
});

test("the model gives the newest, once, and every wrench to the charts", () => {
  let now = 0;
  const model = new Model(SCHEMA, () => now);
  const counters = { bad_crc: 0, malformed: 0, oversize: 0, incomplete: 0, lost: 0, echo: 0 };
  expect(model.take(counters, 0)).toBeUndefined();
  for (let i = 1; i <= 5; i++) {
    now = 10 * i + (i === 4 ? 7 : 0);
    const stamp = { captureUs: BigInt(10_000 * i), frame: BigInt(i), flags: i };
    const valid = i === 3 ? 3 : 1;
    const frame = { type: 4, sensor: 0, sequence: i, flags: 2, payload: new Uint8Array() };
    model.keep(frame, "WRENCH", message("Wrench", { stamp, forceZUn: BigInt(-i), validity: Array(6).fill(valid) }));
  }
  const snapshot = model.take(counters, 3)!;
  const news = snapshot.sensors[0]![1];
  expect(news.wrench!.frame).toBe(5);
  expect(news).toMatchObject({ isSimulated: true, isReplay: false, flags: ["NO_REFERENCE", "UNCALIBRATED_Z"] });
  const rows = Array.from({ length: 5 }, (_, i) => news.trace[7 * i + 3]!);
  expect(rows.map((v) => (Number.isNaN(v) ? "gap" : v.toFixed(7)))).toEqual(["-0.0000010", "-0.0000020", "gap", "-0.0000040", "-0.0000050"]);
  expect(snapshot.health).toMatchObject({ notShown: 4, notSent: 3 });
  expect(snapshot.health.delays.slice(0, 4)).toEqual([4, 0, 0, 1]);
  expect(model.take(counters, 3)).toBeUndefined();
});

test("hostile messages of every type go through the model without an exception", () => {
  const next = randomNumbers(11);
  const model = new Model(SCHEMA, () => 0);
  const decoder = new Decoder();
  const counters = decoder.counters;
  const names = ["WRENCH", "FIELD", "DEPTH", "CONTACTS", "MARKERS", "IMAGE", "EVENT", "LEARNED", "RESIDUAL", "STATUS"];
  let nKept = 0;
  for (let i = 0; i < 20_000; i++) {
    const name = names[next() % names.length]!;
    const payload = Uint8Array.from({ length: next() % 24 }, () => (next() % 3 ? next() % 64 : next() & 255));
    for (const frame of decoder.feed(said(name, payload, i))) {
      const decoded = SCHEMA.decode(frame.type, frame.payload);
      if (!decoded) continue;
      nKept++;
      model.keep(frame, name, decoded);
      model.take(counters, 0);
    }
  }
  expect(nKept).toBeGreaterThan(500);
});

test("what a field costs is printed", () => {
  const next = randomNumbers(7);
  const values = Array.from({ length: 3600 }, () => (next() % 2000) - 1000);
  const payload = SCHEMA.encode("Field", {
    stamp: { frame: 1n }, forceLsbUn: 10, force: dense(40, 30, 3, values),
    displacementLsbNm: 100, displacement: dense(40, 30, 3, values), validity: [1, 1, 1],
  }); // prettier-ignore
  const n = 500;
  const start = performance.now();
  let total = 0;
  for (let i = 0; i < n; i++) total += fieldOf(SCHEMA.decode(5, payload)!).force.length;
  const us = (1e3 * (performance.now() - start)) / n;
  console.log(`decode of a field of 1,200 nodes, force and displacement, ${payload.length} bytes: ${us.toFixed(0)} us`);
  expect(total).toBe(n * 3600);
});

test("displacement is in metres, and a covariance that is not valid is not shown", () => {
  const ones = dense(1, 1, 3, [1, 1, 1]);
  const field = fieldOf(message("Field", { forceLsbUn: 10, force: ones, displacementLsbNm: 125, displacement: ones }));
  field.displacement!.forEach((u) => expect(u * 1e9).toBeCloseTo(125, 3));
  const covariance = Array(21).fill(4n);
  const validity = Array(6).fill(1);
  expect(wrenchOf(message("Wrench", { validity, covariance, covarianceValidity: 1 })).sigma![0]).toBeCloseTo(2e-6, 12);
  expect(wrenchOf(message("Wrench", { validity, covariance, covarianceValidity: 3 })).sigma).toBeUndefined();
});
