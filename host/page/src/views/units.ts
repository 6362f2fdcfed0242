// Numbers as they are shown. What is no number is shown as a dash, never as 0.

export interface Unit {
  name: string; // of force
  perN: number;
  digits: number; // behind the point, of force
  nodeName: string; // of a single node's force, which is a thousand times smaller
  nodePerN: number;
  momentName: string;
  perNm: number;
}

export const UNITS: Unit[] = [
  { name: "N", perN: 1, digits: 3, nodeName: "mN", nodePerN: 1e3, momentName: "N mm", perNm: 1e3 },
  { name: "mN", perN: 1e3, digits: 1, nodeName: "mN", nodePerN: 1e3, momentName: "mN m", perNm: 1e3 },
  { name: "gf", perN: 101.9716, digits: 2, nodeName: "mgf", nodePerN: 101971.6, momentName: "gf cm", perNm: 10197.16 },
];

export const ABSENT = "–";

/** With `digits` behind the point; a minus sign as wide as a plus. */
export function text(value: number | undefined, digits = 3): string {
  if (value === undefined || Number.isNaN(value)) return ABSENT;
  const said = value.toFixed(digits);
  return said.startsWith("-") ? `−${said.slice(1)}` : said;
}

/** Three figures that matter. */
export function short(value: number | undefined): string {
  if (value === undefined || Number.isNaN(value)) return ABSENT;
  const size = Math.abs(value);
  return text(value, size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3);
}

/** Words for a Validity that is not VALID. */
export const VALIDITY_WORDS = ["not measured", "", "uncalibrated", "invalid"];
