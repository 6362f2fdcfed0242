// Protobuf messages from a FileDescriptorSet: no generated module, and an old page decodes a new sensor.

import {
  create,
  createFileRegistry,
  type DescEnum,
  type DescMessage,
  type FileRegistry,
  fromBinary,
  type Message,
  toBinary,
} from "@bufbuild/protobuf";
import { FileDescriptorSetSchema } from "@bufbuild/protobuf/wkt";

const TYPE_PREFIX = "MESSAGE_TYPE_";
const PACKAGE = "ruffini";

/** A decoded message: camelCase fields, 64-bit integers as bigint. */
export type Decoded = Message & Record<string, any>; // eslint-disable-line @typescript-eslint/no-explicit-any

/** Message types and enumerations of one schema. */
export class Schema {
  private readonly registry: FileRegistry;
  private readonly numbers = new Map<string, number>();
  private readonly messages = new Map<number, [string, DescMessage]>();

  /** Throws where the bytes are no schema of ours. */
  constructor(readonly bytes: Uint8Array) {
    this.registry = createFileRegistry(fromBinary(FileDescriptorSetSchema, bytes));
    for (const value of this.enumeration("MessageType").values) {
      const name = value.name.replace(TYPE_PREFIX, "");
      this.numbers.set(name, value.number);
      // MESSAGE_TYPE_AB_CD is the message AbCd.
      const pascal = name.toLowerCase().replace(/(?:^|_)([a-z])/g, (_, letter: string) => letter.toUpperCase());
      const message = this.registry.getMessage(`${PACKAGE}.${pascal}`);
      if (message) this.messages.set(value.number, [name, message]);
    }
  }

  /** 4 for WRENCH; undefined for a type that this schema does not know. */
  typeNumber(name: string): number | undefined {
    return this.numbers.get(name);
  }

  typeName(number: number): string | undefined {
    return this.messages.get(number)?.[0];
  }

  /** The message of a packet; undefined for an unknown type and for bytes that are not that message. */
  decode(type: number, payload: Uint8Array): Decoded | undefined {
    const found = this.messages.get(type);
    if (!found) return undefined;
    try {
      return fromBinary(found[1], payload) as Decoded;
    } catch {
      return undefined;
    }
  }

  /** Bytes of a message, e.g. encode("Command", { requestId: 1, action: { case: "zero", value: {...} } }). */
  encode(name: string, fields: Record<string, unknown>): Uint8Array {
    const desc = this.registry.getMessage(`${PACKAGE}.${name}`);
    if (!desc) throw new RangeError(`the sensor's schema has no ${name}`);
    return toBinary(desc, create(desc, fields));
  }

  /** Name of an enumeration's value without what all share, e.g. enumName("ContactKind", 1) -> "PLANAR". */
  enumName(name: string, number: number): string | undefined {
    const desc = this.enumeration(name);
    return desc.values.find((v) => v.number === number)?.name.slice(sharedLength(desc));
  }

  /** Names of the bits of a mask, e.g. bits("FlagBit", 4) -> ["UNCALIBRATED_Z"]; what is not known as its number. */
  bits(name: string, mask: number): string[] {
    const desc = this.enumeration(name);
    const out: string[] = [];
    for (let bit = 0; bit < 32; bit++) {
      const number = 2 ** bit;
      if (!((mask >>> bit) & 1)) continue;
      out.push(desc.values.find((v) => v.number === number)?.name.slice(sharedLength(desc)) ?? `UNKNOWN_${number}`);
    }
    return out;
  }

  private enumeration(name: string): DescEnum {
    const desc = this.registry.getEnum(`${PACKAGE}.${name}`);
    if (!desc) throw new RangeError(`the sensor's schema has no ${name}`);
    return desc;
  }
}

/** FLAG_ of FLAG_NONE, FLAG_STALE, ...; CONTACT_KIND_ of CONTACT_KIND_PLANAR, ... */
function sharedLength(desc: DescEnum): number {
  const names = desc.values.map((v) => v.name);
  let n = 0;
  while (names.every((name) => n < name.length && name[n] === names[0]![n])) n++;
  return names[0]!.lastIndexOf("_", n - 1) + 1;
}
