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

const N_HUES = 256;
const WHEEL: Rgb[] = Array.from({ length: N_HUES }, (_, i) => oklch(0.72, 0.13, (2 * Math.PI * i) / N_HUES));

/** A direction as a hue of even lightness (OKLCH); an arrow beside it says the same without colour. */
export function wheel(angleRad: number): Rgb {
  const turn = angleRad / (2 * Math.PI);
  return WHEEL[Math.floor((turn - Math.floor(turn)) * N_HUES) % N_HUES]!;
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
