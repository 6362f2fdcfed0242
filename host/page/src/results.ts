// Results of the stream in SI units. What is not measured is NaN or undefined, never 0.

import { decodeDense, type DenseMessage } from "./wire/dense";
import type { Decoded } from "./wire/schema";

export const NOT_MEASURED = 0;
export const VALID = 1;
export const UNCALIBRATED = 2;
export const INVALID = 3;

export interface Stamp {
  captureS: number;
  frame: number;
  flags: number;
}

/** Force (N) and moment (N m) on the pad about the undeformed pad's centre. */
export interface Wrench extends Stamp {
  values: number[]; // 6, NaN where not measured
  validity: number[]; // 6
  sigma: number[] | undefined; // 6; undefined: not measured
}

/** Nodal values, x fastest. */
export interface Field extends Stamp {
  nX: number;
  nY: number;
  force: Float32Array; // 3 a node, N
  displacement: Float32Array | undefined; // 3 a node, m
  validity: number[]; // x, y, z
  slip: Int32Array | undefined; // 1 a node: 0 nothing presses, 1 sticks, 2 slips
  sigma: Float32Array | undefined; // 3 a node, N
}

export interface Depth extends Stamp {
  nX: number;
  nY: number;
  stepPx: number;
  depth: Float32Array; // m, negative where pressed
  validity: number;
}

export interface Contact {
  id: number;
  areaM2: number; // NaN: not known
  center: [number, number]; // m
  force: [number, number, number]; // N, NaN where not measured
  validity: number;
  slipState: number; // 0 not measured, 1 sticks, 2 begins to slip, 3 slides
  shearRatio: number;
  friction: number; // NaN: not known
  slipMarginN: number;
  reachesBorder: boolean;
  placeM: number[] | undefined; // on a body that is not flat, in the camera's axes
  normalForceN: number[] | undefined; // likewise
  tool: { placeM: number[]; rollRad: number; pitchRad: number } | undefined; // of a fingertip's
  shoreA: number;
  gelDepthM: number;
  kind: number;
}

export interface Contacts extends Stamp {
  contacts: Contact[];
  nFound: number;
}

/** What the forces leave unexplained of the displacement, standard deviations: about 1 where all is as calibrated. */
export interface Residual extends Stamp {
  nX: number;
  nY: number;
  size: Float32Array; // 1 a node: root of the mean square of x, y, z
  validity: number;
}

export interface Image extends Stamp {
  width: number;
  height: number;
  rgba: Uint8ClampedArray<ArrayBuffer>;
}

export interface Learned extends Stamp {
  quantities: [string, number][];
  isValid: boolean;
  latencyS: number;
}

type Any = Decoded;

function stampOf(m: Any): Stamp {
  const s = m["stamp"] as Any | undefined;
  if (!s) return { captureS: 0, frame: 0, flags: 0 };
  return { captureS: Number(s["captureUs"]) * 1e-6, frame: Number(s["frame"]), flags: s["flags"] as number };
}

/** A validity that this page does not know is not to be trusted. */
function known(validity: number | undefined): number {
  return validity === undefined ? NOT_MEASURED : validity > INVALID || validity < 0 ? INVALID : validity;
}

function three(list: number[]): number[] {
  return [0, 1, 2].map((i) => known(list[i]));
}

function scaled(values: Int32Array, unit: number): Float32Array {
  const out = new Float32Array(values.length);
  for (let i = 0; i < values.length; i++) out[i] = values[i]! * unit;
  return out;
}

const WRENCH_PARTS = ["forceXUn", "forceYUn", "forceZUn", "torqueXUnUm", "torqueYUnUm", "torqueZUnUm"];
const COVARIANCE_SIZE = 21;

export function wrenchOf(m: Any): Wrench {
  const validity = WRENCH_PARTS.map((_, i) => known((m["validity"] as number[])[i]));
  const values = WRENCH_PARTS.map((part, i) =>
    validity[i] === NOT_MEASURED ? NaN : Number(m[part]) * (i < 3 ? 1e-6 : 1e-12),
  );
  const upper = (m["covariance"] ?? []) as bigint[];
  const isStated = known(m["covarianceValidity"] as number | undefined) === VALID && upper.length === COVARIANCE_SIZE;
  // The diagonal of an upper triangle by rows of 6, 5, 4, ...; (uN)^2 and (uN mm)^2.
  const sigma = [0, 6, 11, 15, 18, 20].map((at, i) => Math.sqrt(Number(upper[at])) * (i < 3 ? 1e-6 : 1e-9));
  return { ...stampOf(m), values, validity, sigma: isStated ? sigma : undefined };
}

/** Throws BadData where a part of it is not what its sizes say, or parts are of different sizes. */
export function fieldOf(m: Any): Field {
  const dense = m["force"] as DenseMessage | undefined;
  const force = dense ? decodeDense(dense) : new Int32Array();
  const [nX, nY] = [dense?.nX ?? 0, dense?.nY ?? 0];
  const lsb = (m["forceLsbUn"] as number) * 1e-6;
  const part = (name: string, nComponents: number): Int32Array | undefined => {
    const found = m[name] as DenseMessage | undefined;
    if (!found || found.nX !== nX || found.nY !== nY || found.nComponents !== nComponents) return undefined;
    return decodeDense(found);
  };
  const displacement = part("displacement", 3);
  const sigma = known(m["sigmaValidity"] as number | undefined) === VALID ? part("sigma", 3) : undefined;
  const isWhole = dense?.nComponents === 3;
  return {
    ...stampOf(m),
    nX: isWhole ? nX : 0,
    nY: isWhole ? nY : 0,
    force: scaled(force, lsb),
    displacement: displacement && scaled(displacement, (m["displacementLsbNm"] as number) * 1e-9),
    validity: three(m["validity"] as number[]),
    slip: part("slip", 1),
    sigma: sigma && scaled(sigma, lsb),
  };
}

export function depthOf(m: Any): Depth {
  const dense = m["depth"] as DenseMessage | undefined;
  const validity = known(m["validity"] as number);
  const depth = dense && dense.nComponents === 1 ? scaled(decodeDense(dense), (m["depthLsbNm"] as number) * 1e-9) : new Float32Array();
  return { ...stampOf(m), nX: dense?.nX ?? 0, nY: dense?.nY ?? 0, stepPx: m["stepPx"] as number, depth, validity };
}

/** Throws BadData as fieldOf does. */
export function residualOf(m: Any): Residual {
  const dense = m["residual"] as DenseMessage | undefined;
  if (dense?.nComponents !== 3) return { ...stampOf(m), nX: 0, nY: 0, size: new Float32Array(), validity: NOT_MEASURED };
  const values = scaled(decodeDense(dense), (m["residualLsb1e6"] as number) * 1e-6);
  const size = new Float32Array(values.length / 3);
  for (let i = 0; i < size.length; i++) size[i] = Math.hypot(values[3 * i]!, values[3 * i + 1]!, values[3 * i + 2]!) / Math.sqrt(3);
  return { ...stampOf(m), nX: dense.nX, nY: dense.nY, size, validity: known(m["validity"] as number) };
}

function contactOf(m: Any): Contact {
  const validity = known(m["validity"] as number);
  const own = (m["forceValidity"] ?? []) as number[];
  const force = ["forceXUn", "forceYUn", "forceZUn"].map((part, i) => {
    const v = own.length === 3 ? known(own[i]) : validity;
    return v === NOT_MEASURED ? NaN : Number(m[part]) * 1e-6;
  });
  const slipState = (m["slipState"] ?? 0) as number;
  const friction = slipState && m["friction1e3"] ? m["friction1e3"] * 1e-3 : NaN;
  const list = (name: string): number[] | undefined => {
    const found = (m[name] ?? []) as (number | bigint)[];
    return found.length ? found.map((v) => Number(v) * 1e-6) : undefined;
  };
  const [tool, turn] = [list("toolUm"), list("turnUrad")];
  return {
    id: m["id"] as number,
    areaM2: m["areaUm2K"] ? m["areaUm2K"] * 1e-9 : NaN,
    center: [m["centerXUm"] * 1e-6, m["centerYUm"] * 1e-6],
    force: force as [number, number, number],
    validity,
    slipState,
    shearRatio: slipState ? m["shearRatio1e3"] * 1e-3 : NaN,
    friction,
    slipMarginN: Number.isNaN(friction) ? NaN : Number(m["slipMarginUn"]) * 1e-6,
    reachesBorder: Boolean(m["reachesBorder"]),
    placeM: list("placeUm"),
    normalForceN: list("normalForceUn"),
    tool: tool && turn ? { placeM: tool, rollRad: turn[0]!, pitchRad: turn[1]! } : undefined,
    shoreA: known(m["hardnessValidity"]) === VALID ? m["shoreA1e1"] * 0.1 : NaN,
    gelDepthM: known(m["depthValidity"]) === VALID ? m["gelDepthUm"] * 1e-6 : NaN,
    kind: (m["kind"] ?? 0) as number,
  };
}

export function contactsOf(m: Any): Contacts {
  return { ...stampOf(m), contacts: (m["contacts"] as Any[]).map(contactOf), nFound: m["nFound"] as number };
}

/** undefined where the bytes are not as many as the size says. */
export function imageOf(m: Any): Image | undefined {
  const [width, height, data] = [m["widthPx"] as number, m["heightPx"] as number, m["data"] as Uint8Array];
  const n = width * height;
  const nChannels = m["format"] === 0 ? 1 : 3; // grey, or B G R
  if (n === 0 || data.length !== n * nChannels) return undefined;
  const rgba = new Uint8ClampedArray(4 * n);
  for (let i = 0, at = 0; i < n; i++, at += nChannels) {
    rgba[4 * i] = data[at + nChannels - 1]!;
    rgba[4 * i + 1] = data[at + (nChannels >> 1)]!;
    rgba[4 * i + 2] = data[at]!;
    rgba[4 * i + 3] = 255;
  }
  return { ...stampOf(m), width, height, rgba };
}

export function learnedOf(m: Any): Learned {
  const quantities = (m["quantities"] as Any[]).map((q): [string, number] => [q["name"] as string, Number(q["value"])]);
  return { ...stampOf(m), quantities, isValid: known(m["validity"] as number) === VALID, latencyS: m["latencyUs"] * 1e-6 };
}
