/** What server and page tell each other: the JSON messages, and the two kinds of binary frames. */

export const VERSION = 2;

export type Kind = "number" | "text" | "bool" | "choice" | "vector";
export type Value = number | string | boolean | number[] | null;
export type Level = "info" | "warn" | "error";

/** A parameter of the scene or of the node, with what it may be. */
export interface Item {
  name: string;
  group: string;
  value: Value;
  kind: Kind;
  low: number | null;
  high: number | null;
  unit: string;
  choices: string[];
  doc: string;
  live: boolean;
  log: boolean;
  optional?: boolean;
}

export interface Hello {
  type: "hello";
  version: number;
  source: "node" | "bag";
  title: string;
  client: number;
  drive: boolean;
  scenes: string[];
  scene: string;
  bag?: { name: string; duration: number };
  recorded?: Recorded[];
}

/** A recording that can be fetched. */
export interface Recorded {
  name: string;
  url: string;
  bytes: number | null;
}

/** Of the time since the last one; what is not known is null. */
export interface Status {
  type: "status";
  rate: number | null;
  real_time_factor: number | null;
  late: number | null;
  late_percent: number | null;
  overruns: number | null;
  step_ms: { p50: number | null; p99: number | null } | null;
  limited: number | null;
  locked: number | null;
  tets: number | null;
  contact_nodes: number | null;
  contact_area: number | null; // m²
  penetration: number | null; // m
  words: { code: string; text: string; level: Level }[];
  command: { age: number | null; rate: number | null; delay: number | null; mode: string | null } | null;
  accuracy: string | null;
  level_errors: Record<string, string> | null;
  recording: { on: boolean; name: string | null; messages: number | null; dropped: number | null } | null;
  phase: "starting" | "running" | "gone";
  message: string;
}

export type Told =
  | Hello
  | Status
  | { type: "parameters"; items: Item[] }
  | { type: "values"; values: Record<string, Value> }
  | { type: "handle"; holder: number | null }
  | { type: "notice"; level: Level; text: string }
  | { type: "yaml"; text: string; name: string }
  | ({ type: "recorded" } & Recorded)
  | { type: "position"; time: number; playing: boolean; speed: number };

export type Said =
  | { type: "take" | "release" | "reset" | "yaml" }
  | { type: "set"; name: string; value: Value }
  | { type: "record"; on: boolean }
  | { type: "scene"; name: string }
  | { type: "seek"; time: number }
  | { type: "play"; on: boolean; speed: number }
  | { type: "frames"; hz: number };

export const BONE = 1;
export const NAIL = 2;
export const PAD = 4;

/** The body at rest, in the finger frame [m]. */
export interface Topology {
  kind: "topology";
  generation: number;
  rest: Float32Array; // (N, 3)
  triangles: Uint32Array; // (F, 3)
  tets: Uint32Array; // (T, 4)
  flags: Uint8Array | null; // (N): BONE | NAIL | PAD
  axes: Float32Array | null; // (T, 3, 3): e1 e2 e3 of each tetrahedron
  limits: Float32Array | null; // (3, 2): stretch and compress along e1 e2 e3; NaN: free
}

export const COMMAND_KNOWN = 1;
export const PLANE_KNOWN = 2;
export const DEVICE_KNOWN = 4;
export const VIRTUAL = 8;
export const RESTART = 16; // the samples replace all that came before

export interface Contact {
  node: number;
  force: [number, number, number]; // N, world
  slips: boolean;
}

export interface Sample {
  time: number; // s, as Frame.time
  normal: number; // N
  tangential: number; // N
  device: number; // N
  depth: number; // mm
}

/** The body at one time; poses are position [m] and orientation xyzw, vectors in world axes. */
export interface Frame {
  kind: "frame";
  generation: number;
  seq: number;
  time: number; // s
  bits: number;
  flags: number;
  pose: Float32Array;
  command: Float32Array;
  plane: Float32Array;
  force: Float32Array;
  torque: Float32Array; // about the origin of the finger frame
  deviceForce: Float32Array;
  centre: Float32Array; // centre of pressure [m]; NaN: none
  friction: number;
  depth: number; // m
  positions: Float32Array; // (N, 3) m
  strain: Uint8Array; // (N): 128 at the limit
  contacts: Contact[];
  samples: Sample[];
}

const DRAWN = 1;
const HELD = 2;

/** What is said as often as a picture is drawn: the last frame that was, and maybe where the finger is sent. */
export function encode(seq: number, pose: number[] | null): ArrayBuffer {
  const view = new DataView(new ArrayBuffer(pose === null ? 8 : 64));
  view.setUint32(0, pose === null ? DRAWN : HELD, true);
  view.setUint32(4, seq, true);
  pose?.forEach((value, k) => view.setFloat64(8 + 8 * k, value, true));
  return view.buffer;
}

const padded = (bytes: number): number => (bytes + 3) & ~3;

/** A binary message. Throws an Error that says what is wrong with its length or kind. */
export function decode(buffer: ArrayBuffer): Topology | Frame {
  if (buffer.byteLength < 32) throw new Error(`a binary message of ${buffer.byteLength} bytes`);
  const view = new DataView(buffer);
  const kind = view.getUint32(0, true);
  if (kind === 1) return topology(buffer, view);
  if (kind === 2) return frame(buffer, view);
  throw new Error(`a binary message of kind ${kind}`);
}

/** Hands out one array after the other of a message. */
class Reader {
  constructor(
    private readonly buffer: ArrayBuffer,
    private at: number,
  ) {}

  floats(count: number): Float32Array {
    return new Float32Array(this.buffer, this.take(4 * count), count);
  }

  words(count: number): Uint32Array {
    return new Uint32Array(this.buffer, this.take(4 * count), count);
  }

  bytes(count: number): Uint8Array {
    return new Uint8Array(this.buffer, this.take(padded(count)), count);
  }

  get left(): number {
    return this.buffer.byteLength - this.at;
  }

  take(bytes: number): number {
    const at = this.at;
    if (at + bytes > this.buffer.byteLength) throw new Error(`a binary message cut off at ${this.buffer.byteLength} bytes`);
    this.at += bytes;
    return at;
  }
}

function topology(buffer: ArrayBuffer, view: DataView): Topology {
  const [generation, nodes, triangles, tets, flags] = [4, 8, 12, 16, 20].map((at) => view.getUint32(at, true));
  const reader = new Reader(buffer, 32);
  const rest = reader.floats(3 * nodes);
  const faces = reader.words(3 * triangles);
  const cells = reader.words(4 * tets);
  const marks = reader.bytes(nodes);
  const known = (flags & 2) !== 0;
  return {
    kind: "topology",
    generation,
    rest,
    triangles: faces,
    tets: cells,
    flags: (flags & 1) !== 0 ? marks : null,
    axes: known ? reader.floats(9 * tets) : null,
    limits: reader.left >= 24 ? reader.floats(6) : null,
  };
}

function frame(buffer: ArrayBuffer, view: DataView): Frame {
  const [generation, seq, nodes] = [4, 8, 12].map((at) => view.getUint32(at, true));
  const [contacts, samples, bits, flags] = [24, 28, 32, 36].map((at) => view.getUint32(at, true));
  const time = view.getFloat64(16, true);
  const head = new Reader(buffer, 40);
  const [pose, command, plane] = [head.floats(7), head.floats(7), head.floats(7)];
  const [force, torque, deviceForce] = [head.floats(3), head.floats(3), head.floats(3)];
  head.floats(3); // the device's torque
  const centre = head.floats(3);
  const [friction, depth] = head.floats(2);
  const body = new Reader(buffer, 256);
  const positions = body.floats(3 * nodes);
  const strain = body.bytes(nodes);
  const touching: Contact[] = [];
  for (let k = 0; k < contacts; k++) {
    const at = body.take(20);
    const force = [4, 8, 12].map((offset) => view.getFloat32(at + offset, true)) as Contact["force"];
    touching.push({ node: view.getUint32(at, true), force, slips: view.getUint32(at + 16, true) === 1 });
  }
  const since: Sample[] = [];
  for (let k = 0; k < samples; k++) {
    const [t, normal, tangential, device, depth] = body.floats(5);
    since.push({ time: time + t, normal, tangential, device, depth });
  }
  return {
    kind: "frame", generation, seq, time, bits, flags, pose, command, plane, force, torque, deviceForce, centre,
    friction, depth, positions, strain, contacts: touching, samples: since,
  }; // prettier-ignore
}
