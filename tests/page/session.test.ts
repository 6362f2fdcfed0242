// The host's side of a conversation: asked again what was lost, refused what was refused, hostile bytes survived.

import { createHash } from "node:crypto";
import { CommandError, Session } from "../../host/page/src/session";
import { Heard, said, saidAs, SCHEMA } from "./device";
import { ownSchema, randomNumbers } from "./golden";

const OWN_SHA256 = new Uint8Array(createHash("sha256").update(ownSchema()).digest());

function converse(sha256: Uint8Array = OWN_SHA256) {
  const heard = new Heard();
  const events = { hellos: 0, problems: [] as string[], messages: [] as string[] };
  const session = new Session(heard.take, SCHEMA, OWN_SHA256, {
    onHello: () => events.hellos++,
    onMessage: (_, name) => events.messages.push(name),
    onProblem: (text) => events.problems.push(text),
  });
  const hello = { protocolVersion: 1, schemaSha256: sha256, deviceSerial: "7" };
  return { heard, events, session, hello };
}

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

test("HELLO is asked until it is answered, and results count from then on", () => {
  const { heard, events, session, hello } = converse();
  vi.advanceTimersByTime(1700);
  expect(heard.names()).toEqual(["HELLO", "HELLO", "HELLO", "HELLO"]);
  session.feed(saidAs("WRENCH", "Wrench", {}));
  session.feed(saidAs("HELLO", "Hello", hello));
  session.feed(saidAs("WRENCH", "Wrench", {}, 1));
  vi.advanceTimersByTime(10_000);
  expect(heard.frames.length).toBe(4);
  expect(events).toEqual({ hellos: 1, problems: [""], messages: ["WRENCH"] });
});

test("who does not answer is said to be silent", () => {
  const { events } = converse();
  vi.advanceTimersByTime(5000);
  expect(events.problems[0]).toContain("Nothing answers");
});

test("a line of broken frames is said to be of another version", () => {
  const { events, session } = converse();
  session.feed(Uint8Array.from([9, 1, 2, 0, 9, 1, 2, 0]));
  vi.advanceTimersByTime(5000);
  expect(events.problems[0]).toContain("not protocol version 1");
});

test("a sensor of another version of the schema is asked for it, until it comes", () => {
  const { heard, events, session, hello } = converse(new Uint8Array(32));
  session.feed(saidAs("HELLO", "Hello", hello));
  vi.advanceTimersByTime(1200);
  expect(heard.names()).toEqual(["HELLO", "SCHEMA", "SCHEMA", "SCHEMA"]);
  expect(events.hellos).toBe(0);
  session.feed(saidAs("SCHEMA", "Schema", { fileDescriptorSet: ownSchema() }));
  expect(events.hellos).toBe(1);
});

test("a schema that is none is said to be so", () => {
  const { events, session, hello } = converse(new Uint8Array(32));
  session.feed(saidAs("HELLO", "Hello", hello));
  session.feed(saidAs("SCHEMA", "Schema", { fileDescriptorSet: Uint8Array.from([1, 2, 3]) }));
  expect(events.hellos).toBe(0);
  expect(events.problems.at(-1)).toContain("cannot be read");
});

test("a command is repeated under its id, and its own reply ends it", async () => {
  const { heard, session, hello } = converse();
  session.feed(saidAs("HELLO", "Hello", hello));
  const reply = session.command("zero", { nFrames: 5 });
  vi.advanceTimersByTime(1100);
  const commands = heard.commands();
  expect(commands.map((c) => c["requestId"])).toEqual(Array(3).fill(commands[0]!["requestId"]));
  expect(commands[0]!["action"].case).toBe("zero");
  session.feed(saidAs("REPLY", "Reply", { requestId: commands[0]!["requestId"] + 1, text: "not yours" }));
  session.feed(saidAs("REPLY", "Reply", { requestId: commands[0]!["requestId"], text: "learning" }));
  expect((await reply)["text"]).toBe("learning");
  vi.advanceTimersByTime(5000);
  expect(heard.commands().length).toBe(3);
});

test("a refusal and a silence end a command with a sentence", async () => {
  const { heard, session, hello } = converse();
  session.feed(saidAs("HELLO", "Hello", hello));
  const refused = session.command("flashUndo");
  session.feed(saidAs("REPLY", "Reply", { requestId: heard.commands()[0]!["requestId"], code: 4, text: "nothing before" }));
  await expect(refused).rejects.toThrow("nothing before");
  const unheard = session.command("zero");
  const outcome = expect(unheard).rejects.toThrow(CommandError);
  vi.advanceTimersByTime(60_000);
  await outcome;
});

test("types that the sensor does not know are not asked for", () => {
  const { heard, session, hello } = converse();
  session.feed(saidAs("HELLO", "Hello", hello));
  void session.subscribe({ wrench: 1, telepathy: 1 });
  const asked = heard.commands()[0]!["action"].value.subscriptions as { type: number; every: number }[];
  expect(asked.map(({ type, every }) => [type, every])).toEqual([[SCHEMA.typeNumber("WRENCH"), 1]]);
  session.stop();
});

test("random payloads under right CRCs never throw", () => {
  const { events, session, hello } = converse();
  session.feed(saidAs("HELLO", "Hello", hello));
  const next = randomNumbers(5);
  const names = ["WRENCH", "FIELD", "DEPTH", "CONTACTS", "MARKERS", "IMAGE", "EVENT", "REPLY", "LEARNED", "RESIDUAL", "STATUS", "HELLO", "SCHEMA"];
  for (let i = 0; i < 5000; i++) {
    const payload = Uint8Array.from({ length: next() % 16 }, () => (next() % 3 ? next() % 32 : next() & 255));
    session.feed(said(names[next() % names.length]!, payload, i));
  }
  expect(session.nUndecodable).toBeGreaterThan(1000);
  expect(events.messages.length).toBeGreaterThan(100);
});
