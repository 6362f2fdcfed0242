// A calibration onto a sensor from the page: it is said to be in force once the sensor itself says which one is.

import { createHash, webcrypto } from "node:crypto";
import { flash } from "../../host/page/src/flashing";
import { CommandError, Session } from "../../host/page/src/session";
import { Heard, saidAs, SCHEMA } from "./device";
import { ownSchema } from "./golden";

const OWN_SHA256 = new Uint8Array(createHash("sha256").update(ownSchema()).digest());
const FILE = Uint8Array.from({ length: 5000 }, (_, i) => i);
const FILE_SHA256 = new Uint8Array(createHash("sha256").update(FILE).digest());
const [DURABLE, ACTIVE] = [3, 4]; // FlashState
const STORAGE = 6; // ReplyCode
const HANG_MS = 60_000; // real

beforeEach(() => {
  vi.stubGlobal("crypto", webcrypto);
  vi.useFakeTimers({ toFake: ["setTimeout", "clearTimeout", "Date"] });
});
afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

/** A sensor that takes the file, on trial for `nTrial` questions; asked who it is, it is silent `nSilent` times. */
function sensor(inForce: Uint8Array, { nSilent = 0, nTrial = 2, trialEnds = "" } = {}) {
  const heard = new Heard();
  const told = { hellos: 0, asked: 0 };
  let [nReceived, isGreeted] = [0, false];
  const hello = (sha256: Uint8Array) =>
    saidAs("HELLO", "Hello", { protocolVersion: 1, schemaSha256: OWN_SHA256, deviceSerial: "7", sensors: [{ calibration: { present: true, sha256 } }] });
  const answer = (action: { case: string; value: any }): Record<string, unknown> => {
    if (action.case === "flashChunk") nReceived += action.value.data.length;
    if (action.case === "flashCommit") return { flashState: DURABLE };
    if (action.case === "flashQuery") return nTrial-- > 0 ? { flashState: DURABLE } : { flashState: ACTIVE, code: trialEnds ? STORAGE : 0, text: trialEnds };
    return { nextOffset: BigInt(nReceived) };
  };
  const session: Session = new Session(
    (data) => {
      const nBefore = heard.frames.length;
      heard.take(data);
      for (const frame of heard.frames.slice(nBefore)) {
        const name = SCHEMA.typeName(frame.type);
        if (name === "COMMAND") {
          const { requestId, action } = SCHEMA.decode(frame.type, frame.payload) as Record<string, any>;
          queueMicrotask(() => session.feed(saidAs("REPLY", "Reply", { requestId, ...answer(action) })));
        } else if (isGreeted && told.asked++ >= nSilent) {
          queueMicrotask(() => session.feed(hello(inForce)));
        }
      }
    },
    SCHEMA,
    OWN_SHA256,
    { onHello: () => told.hellos++, onMessage: () => undefined, onProblem: () => undefined },
  );
  session.feed(hello(new Uint8Array(32)));
  isGreeted = true;
  return { session, told };
}

async function flashed(session: Session): Promise<string> {
  const outcome = flash(session, FILE, () => undefined).then(
    () => "in force",
    (error: CommandError) => error.message,
  );
  let result: string | undefined;
  void outcome.then((text) => (result = text));
  const endMs = performance.now() + HANG_MS;
  while (result === undefined && performance.now() < endMs) {
    await vi.advanceTimersByTimeAsync(20);
    await new Promise((resolve) => setImmediate(resolve)); // SHA-256 is another thread's work, however long that takes
  }
  return result ?? "no end";
}

test("it is in force when the sensor says so, however often it has to be asked", async () => {
  const { session, told } = sensor(FILE_SHA256, { nSilent: 3 });
  expect(await flashed(session)).toBe("in force");
  expect(told).toEqual({ hellos: 2, asked: 4 });
});

test("another calibration in force is an error", async () => {
  expect(await flashed(sensor(new Uint8Array(32)).session)).toContain("not the one that was sent");
});

test("a trial that ends with a complaint is an error", async () => {
  expect(await flashed(sensor(FILE_SHA256, { trialEnds: "the medium failed" }).session)).toBe("the medium failed");
});

test("a sensor that never says what is in force is an error", async () => {
  expect(await flashed(sensor(FILE_SHA256, { nSilent: 1000 }).session)).toContain("No reply to HELLO");
});
