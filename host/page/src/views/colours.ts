// Colours as linear-light-free sRGB triples 0..1. The sequential map is cividis, which colour-blind people read alike.

export type Rgb = [number, number, number];

// cividis (Nunez, Anderton and Renslow 2018), nine of its colours.
const CIVIDIS = "00224e 1a386f 434e6c 61656f 7d7c78 9b9476 bcae6c dec958 fee838".split(" ").map((hex): Rgb => {
  const n = parseInt(hex, 16);
  return [(n >> 16) / 255, ((n >> 8) & 255) / 255, (n & 255) / 255];
});

/** 0 = dark blue, 1 = yellow. */
export function sequential(x: number, out: Rgb): Rgb {
  const at = Math.min(Math.max(x, 0), 1) * (CIVIDIS.length - 1);
  const i = Math.min(Math.floor(at), CIVIDIS.length - 2);
  const [a, b, t] = [CIVIDIS[i]!, CIVIDIS[i + 1]!, at - i];
  for (let k = 0; k < 3; k++) out[k] = a[k]! + (b[k]! - a[k]!) * t;
  return out;
}

const N_STEPS = 256;
const packed = ([r, g, b]: Rgb): number => 0xff000000 | (Math.round(255 * b) << 16) | (Math.round(255 * g) << 8) | Math.round(255 * r);
const SEQUENTIAL = Uint32Array.from({ length: N_STEPS }, (_, i) => packed(sequential(i / (N_STEPS - 1), [0, 0, 0])));

/** `sequential` as a pixel of an ImageData, of a little-endian computer. */
export function sequentialPixel(x: number): number {
  return SEQUENTIAL[Math.min(Math.max(x * (N_STEPS - 1) + 0.5, 0), N_STEPS - 1) | 0]!;
}

/** Of the screen (sRGB) to light that is linear, as three.js wants it. */
export function linear(c: number): number {
  return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
}

const SEQUENTIAL_LIGHT = Float32Array.from({ length: 3 * N_STEPS }, (_, i) => linear(sequential(Math.floor(i / 3) / (N_STEPS - 1), [0, 0, 0])[i % 3]!));

/** `sequential` as linear light into out[at ...]. */
export function sequentialLight(x: number, out: Float32Array, at: number): void {
  const from = 3 * (Math.min(Math.max(x * (N_STEPS - 1) + 0.5, 0), N_STEPS - 1) | 0);
  out[at] = SEQUENTIAL_LIGHT[from]!;
  out[at + 1] = SEQUENTIAL_LIGHT[from + 1]!;
  out[at + 2] = SEQUENTIAL_LIGHT[from + 2]!;
}

const DARK = 0.12; // of a direction without size

/** `wheel` as a pixel, the darker the smaller `share` (0 to 1). */
export function wheelPixel(angleRad: number, share: number): number {
  const [r, g, b] = wheel(angleRad);
  const mixed = (c: number): number => (255 * (DARK + (c - DARK) * share) + 0.5) | 0;
  return (0xff000000 | (mixed(b) << 16) | (mixed(g) << 8) | mixed(r)) >>> 0;
}

const N_HUES = 256;
const WHEEL: Rgb[] = Array.from({ length: N_HUES }, (_, i) => oklch(0.72, 0.13, (2 * Math.PI * i) / N_HUES));

/** A direction as a hue of even lightness (OKLCH); an arrow beside it says the same without colour. */
export function wheel(angleRad: number): Rgb {
  const turn = angleRad / (2 * Math.PI);
  return WHEEL[Math.floor((turn - Math.floor(turn)) * N_HUES) % N_HUES]!;
}

const WHEEL_LIGHT = Float32Array.from(WHEEL.flat(), linear);

/** `wheel` as linear light into out[at ...]. */
export function wheelLight(angleRad: number, out: Float32Array, at: number): void {
  const turn = angleRad / (2 * Math.PI);
  const from = 3 * (Math.floor((turn - Math.floor(turn)) * N_HUES) % N_HUES);
  out[at] = WHEEL_LIGHT[from]!;
  out[at + 1] = WHEEL_LIGHT[from + 1]!;
  out[at + 2] = WHEEL_LIGHT[from + 2]!;
}

/** Björn Ottosson's OKLab in polar form, to sRGB, cut to its range. */
function oklch(lightness: number, chroma: number, hue: number): Rgb {
  const [a, b] = [chroma * Math.cos(hue), chroma * Math.sin(hue)];
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  const linear = [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
  return linear.map((v) => {
    const c = Math.min(Math.max(v, 0), 1);
    return c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055;
  }) as Rgb;
}

/** Three forces, three moments: Okabe and Ito's colours, which colour-blind people tell apart. */
export const AXIS_COLOURS = ["#e69f00", "#56b4e9", "#009e73"];
