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
  sigmaM: number; // standard deviation where something touches; NaN: not stated
  validity: number;
}

export interface Contact {
  id: number;
  areaM2: number; // NaN: not known
  center: [number, number]; // m
  force: [number, number, number]; // N, NaN where not measured
  peakDepthM: number; // NaN unless valid
  validity: number;
  slipState: number; // 0 not measured, 1 sticks, 2 begins to slip, 3 slides
  shearRatio: number;
  slipShare: number; // of its area
  friction: number; // NaN: not known, as the next two
  frictionSigma: number;
  slipMarginN: number;
  reachesBorder: boolean;
  skin: SkinTouch | undefined;
  tool: ToolTouch | undefined;
  model: ContactModel | undefined;
  flowParts: FlowParts | undefined;
}

/** A touch of a skin, in the camera's axes. */
export interface SkinTouch {
  placeM: number[]; // on the undeformed skin
  normalForceN: number[];
  forceSigmaN: number; // NaN: not stated, as the next
  centerSigmaM: number; // of Contact.center
}

/** A tool that came down along its own axis on a fingertip. */
export interface ToolTouch {
  placeM: number[]; // x, y of its axis, in its own axes, and its way since it touched
  rollRad: number;
  pitchRad: number;
  normalForceN: number[]; // along its axis, in the camera's axes
  forceSigmaN: number;
  placeSigmaM: number[]; // as placeM
  rollSigmaRad: number;
  pitchSigmaRad: number;
  faceAreaSigmaM2: number; // of Contact.areaM2
  flatAreaM2: number; // NaN: not measured, as the next
  flatAreaSigmaM2: number;
}

/** What contact models make of a texture's flow; NaN where its validity is not VALID. */
export interface ContactModel {
  kind: number; // 0 not told, 1 planar, 2 hertzian
  kindConfidence: number;
  gelDepthM: number;
  gelDepthSigmaM: number;
  pressDepthM: number;
  effectiveAreaM2: number;
  depthValidity: number;
  stiffnessPaPerM: number;
  shoreA: number;
  shoreASigma: number;
  hardnessValidity: number;
  meanFlowM: number;
  momentByFlowNm: number;
}

/** Parts of a texture's flow: mean size of its gradient, size of the mean of the rest, turn from x to y. */
export interface FlowParts {
  curlFreeM: number;
  divergenceFreeM: number;
  twistRad: number;
}

/** The last squeeze of an object; NaN unless VALID, infinite: as hard as a rigid one. */
export interface Softness {
  squeeze: number;
  nFrames: number;
  modulusPa: number; // E / (1 - nu^2)
  lowPa: number; // one standard deviation below
  highPa: number; // and above
  logShare: number; // log2 of the dent's curvature over a rigid object's
  logSigma: number;
  validity: number;
}

export interface Contacts extends Stamp {
  contacts: Contact[];
  nFound: number;
  softness?: Softness | undefined; // undefined: the board has no such stage
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
  tookS: number; // the network alone
  latencyS: number;
  periodS: number; // since the result before; 0: the first
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
  return { ...stampOf(m), nX: dense?.nX ?? 0, nY: dense?.nY ?? 0, stepPx: m["stepPx"] as number, depth, validity, sigmaM: stated(m["sigmaUm"], 1e-6) };
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

/** 0 on the wire: not stated. */
function stated(value: number | bigint | undefined, unit: number): number {
  return value ? Number(value) * unit : NaN;
}

function list(values: (number | bigint)[] | undefined, unit: number): number[] {
  return (values ?? []).map((v) => Number(v) * unit);
}

// First field of each stage's message: set if the stage reports something.
const FIRST_FIELD = { slip: "slipState", skin: "placeUm", tool: "toolUm", model: "depthValidity" } as const;

/**
 * A stage's message of a contact. Sensors and recordings from before each stage had one have its fields, by the same names, in
 * the contact itself, which then stands for it.
 */
function partOf(contact: Any, name: keyof typeof FIRST_FIELD): Any | undefined {
  const own = contact[name] as Any | undefined;
  if (own) return own;
  const first = contact[FIRST_FIELD[name]] as number | unknown[] | undefined;
  return (Array.isArray(first) ? first.length : first) ? contact : undefined;
}

function skinOf(part: Any, isValid: boolean): SkinTouch {
  const unless = (values: number[]): number[] => values.map((v) => (isValid ? v : NaN));
  return {
    placeM: unless(list(part["placeUm"], 1e-6)),
    normalForceN: unless(list(part["normalForceUn"], 1e-6)),
    forceSigmaN: isValid ? stated(part["forceSigmaUn"], 1e-6) : NaN,
    centerSigmaM: isValid ? stated(part["centerSigmaUm"], 1e-6) : NaN,
  };
}

function toolOf(part: Any, isValid: boolean): ToolTouch | undefined {
  const [place, turn, force] = [list(part["toolUm"], 1e-6), list(part["turnUrad"], 1e-6), list(part["normalForceUn"], 1e-6)];
  if (place.length !== 3 || turn.length !== 2 || force.length !== 3) return undefined;
  const sigma = list(part["toolSigma"], 1e-6);
  const known = (value: number | undefined): number => (isValid && value !== undefined ? value : NaN);
  return {
    placeM: place.map(known),
    rollRad: known(turn[0]),
    pitchRad: known(turn[1]),
    normalForceN: force.map(known),
    forceSigmaN: known(sigma[0]),
    placeSigmaM: [1, 2, 3].map((i) => known(sigma[i])),
    rollSigmaRad: known(sigma[4]),
    pitchSigmaRad: known(sigma[5]),
    faceAreaSigmaM2: known(sigma[6]) * 1e-3,
    flatAreaM2: known(stated(part["flatAreaUm2K"], 1e-9)),
    flatAreaSigmaM2: known(stated(part["flatAreaSigmaUm2K"], 1e-9)),
  };
}

function modelOf(part: Any): ContactModel {
  const [depthValidity, hardnessValidity] = [known(part["depthValidity"]), known(part["hardnessValidity"])];
  const depth = (name: string, unit: number): number => (depthValidity === VALID ? part[name] * unit : NaN);
  const hardness = (name: string, unit: number): number => (hardnessValidity === VALID ? part[name] * unit : NaN);
  const kind = part["kind"] as number;
  return {
    kind,
    kindConfidence: kind ? part["kindSure1e3"] * 1e-3 : NaN,
    gelDepthM: depth("gelDepthUm", 1e-6),
    gelDepthSigmaM: depth("depthSigmaUm", 1e-6),
    pressDepthM: depth("pressDepthUm", 1e-6),
    effectiveAreaM2: depth("effectiveAreaUm2K", 1e-9),
    depthValidity,
    stiffnessPaPerM: hardness("stiffnessPaUm", 1e6),
    shoreA: hardness("shoreA1e1", 0.1),
    shoreASigma: hardness("shoreASigma1e1", 0.1),
    hardnessValidity,
    meanFlowM: part["meanFlowUm"] * 1e-6,
    momentByFlowNm: Number(part["momentByFlowUnmm"]) * 1e-9,
  };
}

function flowPartsOf(part: Any): FlowParts {
  return { curlFreeM: part["curlFreeNm"] * 1e-9, divergenceFreeM: part["divergenceFreeNm"] * 1e-9, twistRad: part["twistUrad"] * 1e-6 };
}

function contactOf(m: Any): Contact {
  const validity = known(m["validity"] as number);
  const own = (m["forceValidity"] ?? []) as number[];
  const ofAxis = (axis: number): number => (own.length === 3 ? known(own[axis]) : validity);
  const force = ["forceXUn", "forceYUn", "forceZUn"].map((part, i) => (ofAxis(i) === NOT_MEASURED ? NaN : Number(m[part]) * 1e-6));
  const [slip, skin, tool, model] = (["slip", "skin", "tool", "model"] as const).map((name) => partOf(m, name));
  const slipState = (slip?.["slipState"] ?? 0) as number;
  const ofSlip = (name: string): number => (slipState && slip ? slip[name] * 1e-3 : NaN);
  const isFrictionKnown = Boolean(slipState && slip?.["friction1e3"]);
  return {
    id: m["id"] as number,
    areaM2: stated(m["areaUm2K"], 1e-9),
    center: [m["centerXUm"] * 1e-6, m["centerYUm"] * 1e-6],
    force: force as [number, number, number],
    peakDepthM: validity === VALID ? m["peakDepthNm"] * 1e-9 : NaN,
    validity,
    slipState,
    shearRatio: ofSlip("shearRatio1e3"),
    slipShare: ofSlip("slipShare1e3"),
    friction: isFrictionKnown ? ofSlip("friction1e3") : NaN,
    frictionSigma: isFrictionKnown ? ofSlip("frictionSigma1e3") : NaN,
    slipMarginN: isFrictionKnown ? Number(slip!["slipMarginUn"]) * 1e-6 : NaN,
    reachesBorder: Boolean(m["reachesBorder"]),
    skin: skin && skinOf(skin, ofAxis(2) === VALID),
    tool: tool && toolOf(tool, ofAxis(2) === VALID),
    model: model && modelOf(model),
    flowParts: m["helmholtz"] && flowPartsOf(m["helmholtz"]),
  };
}

function softnessOf(part: Any): Softness {
  const validity = known(part["validity"] as number);
  const number = (value: number): number => (validity === VALID ? value : NaN);
  return {
    squeeze: part["squeeze"] as number,
    nFrames: part["nFrames"] as number,
    modulusPa: number(part["modulusPa"] || Infinity),
    lowPa: number(part["lowPa"]),
    highPa: number(part["highPa"] || Infinity),
    logShare: number(part["logShareQ16"] / 65536),
    logSigma: number(part["logSigmaQ16"] / 65536),
    validity,
  };
}

export function contactsOf(m: Any): Contacts {
  const softness = m["softness"] ? softnessOf(m["softness"]) : undefined;
  return { ...stampOf(m), contacts: (m["contacts"] as Any[]).map(contactOf), nFound: m["nFound"] as number, softness };
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
  return { ...stampOf(m), quantities, isValid: known(m["validity"] as number) === VALID, tookS: m["tookUs"] * 1e-6, latencyS: m["latencyUs"] * 1e-6, periodS: (m["periodUs"] ?? 0) * 1e-6 };
}
