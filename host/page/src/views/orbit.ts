// The keys of the three dimensions: what dragging and scrolling do, without a mouse.

export type Place = [x: number, y: number, z: number];

const STEP_RAD = Math.PI / 24;
const NEARER = 1.15;
const POLE_RAD = 0.05; // seen from straight above, up is no direction
const STEPS: Record<string, [turn: number, tilt: number, away: number]> = {
  ArrowLeft: [STEP_RAD, 0, 1],
  ArrowRight: [-STEP_RAD, 0, 1],
  ArrowUp: [0, -STEP_RAD, 1],
  ArrowDown: [0, STEP_RAD, 1],
  "+": [0, 0, 1 / NEARER],
  "=": [0, 0, 1 / NEARER], // plus without shift
  "-": [0, 0, NEARER],
};

/** Where the camera goes by a key, from what it looks at; undefined: it is none of these keys. */
export function orbit([x, y, z]: Place, key: string): Place | undefined {
  const step = STEPS[key];
  if (!step) return undefined;
  const [turn, tilt, away] = step;
  const length = Math.hypot(x, y, z);
  const azimuth = Math.atan2(y, x) - turn;
  const polar = Math.min(Math.max(Math.acos(z / length) + tilt, POLE_RAD), Math.PI - POLE_RAD);
  return [Math.sin(polar) * Math.cos(azimuth), Math.sin(polar) * Math.sin(azimuth), Math.cos(polar)].map((c) => c * length * away) as Place;
}
