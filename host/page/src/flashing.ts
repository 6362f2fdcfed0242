// A calibration onto a sensor: upload, commit, trial (proto/README.md, FLASH).

import { CommandError, isEqual, type Session } from "./session";

const CHUNK_BYTES = 3072;
const CHUNK_WAIT_MS = 200;
const CHUNK_TRIES = 40;
const COMMIT_WAIT_MS = 1000; // a slow medium proves, stores and reads back a large file
const COMMIT_TRIES = 30;
const TRIAL_POLL_MS = 100;
const TRIAL_STALL_MS = 10_000; // on trial without a frame: the camera stands still
const DURABLE = 3; // FlashState
const ACTIVE = 4;

/** Resolves when the file is in force for good. Rejects with CommandError: what the sensor says against it. */
export async function flash(session: Session, data: Uint8Array, say: (part: number, text: string) => void): Promise<void> {
  const sha256 = new Uint8Array(await crypto.subtle.digest("SHA-256", data as Uint8Array<ArrayBuffer>));
  await upload(session, data, sha256, say);
  say(1, "The sensor checks and stores it.");
  const committed = await session.command("flashCommit", {}, COMMIT_WAIT_MS, COMMIT_TRIES);
  if (committed["flashState"] === DURABLE) await trial(session, sha256, say);
  else if (committed["flashState"] !== ACTIVE) throw new CommandError(String(committed["text"]));
  const { sensors } = await session.askWho();
  const inForce = sensors[0]?.calibration?.sha256 as Uint8Array | undefined;
  if (!inForce || !isEqual(inForce, sha256)) throw new CommandError("The calibration in force is not the one that was sent.");
}

async function upload(session: Session, data: Uint8Array, sha256: Uint8Array, say: (part: number, text: string) => void): Promise<void> {
  const begun = await session.command("flashBegin", { sizeBytes: BigInt(data.length), sha256 });
  let offset = Number(begun["nextOffset"]);
  for (let nStuck = 0; offset < data.length; ) {
    const part = data.subarray(offset, offset + CHUNK_BYTES);
    // A chunk in the wrong place is refused, too, with the place where the sensor goes on.
    const reply = await session.ask("flashChunk", { offset: BigInt(offset), data: part }, CHUNK_WAIT_MS, CHUNK_TRIES);
    const next = Number(reply["nextOffset"]);
    nStuck = next <= offset ? nStuck + 1 : 0;
    if (nStuck > CHUNK_TRIES) throw new CommandError(`The upload does not go on: ${String(reply["text"])}`);
    offset = next;
    say(offset / data.length, "Sending.");
  }
}

async function trial(session: Session, sha256: Uint8Array, say: (part: number, text: string) => void): Promise<void> {
  let [nFrames, since] = [-1, Date.now()];
  for (;;) {
    const reply = await session.command("flashQuery", { sha256 });
    if (reply["flashState"] !== DURABLE) {
      if (reply["text"]) throw new CommandError(String(reply["text"])); // in force, but not as it should be
      return;
    }
    if (Number(reply["value"]) !== nFrames) [nFrames, since] = [Number(reply["value"]), Date.now()];
    else if (Date.now() - since > TRIAL_STALL_MS) {
      throw new CommandError("It is stored, but the camera gives no frames to try it on: a restart goes back to what was before.");
    }
    say(1, String(reply["text"]) || "On trial.");
    await new Promise((resolve) => setTimeout(resolve, TRIAL_POLL_MS));
  }
}
