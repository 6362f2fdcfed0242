// The newest result of each kind, decoded when it is wanted: what nobody draws costs no decoding.

import { Delays } from "./delays";
import type { LineHealth, SensorNews, Snapshot, Status } from "./messages";
import { contactsOf, depthOf, fieldOf, imageOf, learnedOf, residualOf, wrenchOf } from "./results";
import { type Counters, type Frame, REPLAY, SIMULATED } from "./wire/framing";
import type { Decoded, Schema } from "./wire/schema";

const MAX_TRACE = 4096; // wrenches between two snapshots: more than a minute of a hidden page loses the oldest
const MAX_EVENTS = 64;
const TRACE_ROW = 7;
const LATE = { WRENCH: wrenchOf, FIELD: fieldOf, DEPTH: depthOf, CONTACTS: contactsOf, IMAGE: imageOf, LEARNED: learnedOf, RESIDUAL: residualOf };

interface Sensor {
  newest: Map<string, Decoded>;
  trace: number[];
  stampFlags: number;
  frameFlags: number;
}

export class Model {
  nUndecodable = 0;
  notShown = 0;
  private readonly sensors = new Map<number, Sensor>();
  private status: Decoded | undefined;
  private events: Snapshot["events"] = [];
  private readonly counts = new Map<string, number>();
  private nBytes = 0;
  private since: number;
  private rates: [string, number][] = [];
  private bytesPerS = 0;
  private readonly delays = new Delays();

  constructor(
    private readonly schema: Schema,
    private readonly now: () => number,
  ) {
    this.since = now();
  }

  countBytes(n: number): void {
    this.nBytes += n;
  }

  keep(frame: Frame, name: string, message: Decoded): void {
    this.counts.set(name, (this.counts.get(name) ?? 0) + 1);
    if (name === "STATUS") this.status = message;
    else if (name === "EVENT") this.keepEvent(message);
    else if (name in LATE || name === "MARKERS") this.keepResult(frame, name, message);
  }

  private keepEvent(message: Decoded): void {
    const { severity, what, text } = message as unknown as Snapshot["events"][number];
    this.events.push({ severity, what, text });
    if (this.events.length > MAX_EVENTS) this.events.shift();
  }

  private keepResult(frame: Frame, name: string, message: Decoded): void {
    // A stale WRENCH comes as a packet of the whole device: it is of the one sensor that there is.
    const id = this.sensors.has(frame.sensor) || frame.sensor !== 255 ? frame.sensor : [...this.sensors.keys()][0];
    if (id === undefined) return;
    let sensor = this.sensors.get(id);
    if (!sensor) this.sensors.set(id, (sensor = { newest: new Map(), trace: [], stampFlags: 0, frameFlags: 0 }));
    if (sensor.newest.has(name)) this.notShown++;
    sensor.newest.set(name, message);
    sensor.frameFlags = frame.flags;
    if (name !== "LEARNED") sensor.stampFlags = (message["stamp"]?.["flags"] ?? 0) as number;
    if (name === "WRENCH") this.trace(sensor, message);
  }

  private trace(sensor: Sensor, message: Decoded): void {
    const wrench = wrenchOf(message);
    // A chart shows what is a number in its unit; the rest is a gap.
    const values = wrench.values.map((v, i) => (wrench.validity[i] === 1 ? v : NaN));
    sensor.trace.push(wrench.captureS, ...values);
    if (sensor.trace.length > MAX_TRACE * TRACE_ROW) sensor.trace.splice(0, TRACE_ROW);
    this.delays.add(this.now(), wrench.captureS * 1e3);
  }

  /** All that is new; undefined where nothing is. */
  take(counters: Counters, notSent: number): Snapshot | undefined {
    this.measureRates();
    const sensors: [number, SensorNews][] = [];
    for (const [id, sensor] of this.sensors) if (sensor.newest.size) sensors.push([id, this.newsOf(sensor)]);
    if (!sensors.length && !this.status && !this.events.length) return undefined;
    const snapshot: Snapshot = { sensors, events: this.events, health: this.health(counters, notSent) };
    if (this.status) snapshot.status = statusOf(this.status, this.schema);
    this.status = undefined;
    this.events = [];
    return snapshot;
  }

  private newsOf(sensor: Sensor): SensorNews {
    const news: SensorNews = {
      trace: Float64Array.from(sensor.trace),
      flags: this.schema.bits("FlagBit", sensor.stampFlags),
      isSimulated: (sensor.frameFlags & SIMULATED) !== 0,
      isReplay: (sensor.frameFlags & REPLAY) !== 0,
    };
    for (const [name, message] of sensor.newest) {
      if (!(name in LATE)) continue;
      try {
        Object.assign(news, { [name.toLowerCase()]: LATE[name as keyof typeof LATE](message) });
      } catch {
        this.nUndecodable++; // sizes that its bytes do not bear out
      }
    }
    sensor.newest.clear();
    sensor.trace = [];
    return news;
  }

  private measureRates(): void {
    const elapsedS = (this.now() - this.since) / 1e3;
    if (elapsedS < 1) return;
    this.rates = [...this.counts].map(([name, n]) => [name, n / elapsedS]);
    this.bytesPerS = this.nBytes / elapsedS;
    for (const name of this.counts.keys()) this.counts.set(name, 0);
    this.nBytes = 0;
    this.since = this.now();
  }

  private health(counters: Counters, notSent: number): LineHealth {
    return {
      counters: { ...counters },
      nUndecodable: this.nUndecodable,
      bytesPerS: this.bytesPerS,
      perS: this.rates,
      notSent,
      notShown: this.notShown,
      delays: this.delays.bins(this.now()),
    };
  }
}

function statusOf(m: Decoded, schema: Schema): Status {
  const drops = (m["drops"] ?? {}) as Record<string, unknown>;
  return {
    frameRateHz: m["frameRateMhz"] * 1e-3,
    uptimeS: Number(m["uptimeUs"]) * 1e-6,
    health: schema.bits("HealthBit", m["health"] as number),
    drops: Object.entries(drops)
      .filter(([, n]) => typeof n === "bigint")
      .map(([name, n]) => [name, Number(n)]),
    saturations: Number(m["saturations"]),
    temperatures: (m["temperatures"] as Decoded[]).map((t) => [t["place"] as string, t["milliCelsius"] * 1e-3]),
    stages: (m["stageTimes"] as Decoded[]).map((s) => [s["stage"] as string, s["meanNs"] * 1e-6, s["maxNs"] * 1e-6]),
  };
}
