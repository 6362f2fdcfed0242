// What a sensor says about itself in HELLO, as far as the page shows it. Lengths in metres.

import { parse } from "smol-toml";
import type { Decoded } from "./wire/schema";

export type Shape = { kind: "flat" } | { kind: "tube"; radius: number; length: number } | { kind: "dome"; radius: number };

export interface SensorInfo {
  sensor: number;
  board: string;
  product: string;
  grid: { nX: number; nY: number; originX: number; originY: number; stepX: number; stepY: number };
  stages: string[];
  notMeasured: string[];
  calibration: { isPresent: boolean; kinds: string[]; createdUtc: string; isDevelopmentKey: boolean; isOnTrial: boolean };
  padX: number;
  padY: number;
  thickness: number;
  rateHz: number;
  shape: Shape;
  fieldForces: boolean; // sends forces at nodes
}

type Table = Record<string, unknown>;

/** The board's description; empty where it cannot be read: the page then shows numbers without a body. */
function tables(text: string): (name: string) => Table {
  let all: Table = {};
  try {
    all = parse(text) as Table;
  } catch {
    // shown without it
  }
  return (name) => (all[name] ?? {}) as Table;
}

function metres(table: Table, key: string, other: number): number {
  const value = table[key];
  return typeof value === "number" && value > 0 ? value * 1e-6 : other;
}

export function sensorInfo(m: Decoded): SensorInfo {
  const table = tables(m["boardToml"] as string);
  const stages = m["stages"] as string[];
  const [pad, skin, camera] = [table("pad"), table("skin"), table("camera")];
  const grid = {
    nX: m["gridNX"] as number,
    nY: m["gridNY"] as number,
    originX: m["gridOriginXNm"] * 1e-9,
    originY: m["gridOriginYNm"] * 1e-9,
    stepX: m["gridStepXNm"] * 1e-9,
    stepY: m["gridStepYNm"] * 1e-9,
  };
  const padX = metres(pad, "size_x_um", grid.nX * grid.stepX || 0.02);
  const padY = metres(pad, "size_y_um", grid.nY * grid.stepY || 0.02);
  const c = (m["calibration"] ?? {}) as Decoded;
  let shape: Shape = { kind: "flat" };
  if (skin["shape"] === "tube") shape = { kind: "tube", radius: metres(skin, "radius_um", 0.02), length: padY };
  else if (stages.includes("fingertip")) shape = { kind: "dome", radius: padX / 2 };
  return {
    sensor: m["sensor"] as number,
    board: m["board"] as string,
    product: (m["product"] as string) || (m["board"] as string),
    grid,
    stages,
    notMeasured: m["notMeasured"] as string[],
    calibration: {
      isPresent: Boolean(c["present"]),
      kinds: (c["kinds"] ?? []) as string[],
      createdUtc: (c["createdUtc"] ?? "") as string,
      isDevelopmentKey: Boolean(c["developmentKey"]),
      isOnTrial: Boolean(c["onTrial"]),
    },
    padX,
    padY,
    thickness: metres(pad, "thickness_um", 0.004),
    rateHz: typeof camera["rate_mhz"] === "number" ? camera["rate_mhz"] * 1e-3 : 0,
    shape,
    fieldForces: stages.includes("operator") && grid.nX > 1 && grid.nY > 1,
  };
}
