/** The handle: who holds the finger, where it is wanted, and the poses that are sent while it is held. */

import { Quaternion, Vector3 } from "three";
import type { Ground } from "./ground";
import { COMMAND_KNOWN, VIRTUAL, type Frame, type Said, type Topology } from "./wire";

/** asked: for the handle; letting: it springs back before it is released. */
export type Hold = "free" | "asked" | "mine" | "letting" | "other" | "none";

const FOLLOW = 2 * Math.PI * 8; // rad/s: how fast the sent pose goes after the wanted one
const SPRING = 2 * Math.PI * 3.2; // rad/s, and
const SPRING_DAMPING = 0.62; // of critical: it swings a little when it is let go
const CLEAR = 0.003; // m above the plane, where a finger that is let go comes to rest
const ARRIVED = 5e-5; // m
const LONGEST_RETURN = 1.2; // s
const STEP = 0.004; // s, of the spring
const ASKING = 5; // s after which a question that nobody answers is dropped

interface Pose {
  position: Vector3;
  orientation: Quaternion;
}

export class Handle {
  hold: Hold = "none";
  holder: number | null = null;
  /** Whether it springs back off the plane when it is let go, and how deep it may be pressed [m]. */
  springs = true;
  deepest = 0.0035;
  speed = 0; // m/s, of what is sent
  /** The last pose that was wanted, and its depth [m]. */
  readonly wanted: Pose = { position: new Vector3(), orientation: new Quaternion() };
  private readonly sent: Pose = { position: new Vector3(), orientation: new Quaternion() };
  private readonly velocity = new Vector3();
  private client = -1;
  private drive = false;
  private since = 0;
  private stays = false;
  private skin: Vector3[] = [];
  private frame: Frame | null = null;

  /** send: a pose, as position and orientation xyzw. */
  constructor(
    private readonly say: (message: Said) => void,
    private readonly send: (pose: number[]) => void,
    private readonly ground: Ground,
    private readonly changed: () => void,
  ) {}

  /** Whether moves are taken: it is held, or will be at once. */
  get held(): boolean {
    return this.hold === "mine" || this.hold === "asked";
  }

  welcome(client: number, drive: boolean): void {
    [this.client, this.drive, this.holder] = [client, drive, null];
    this.become(drive ? "free" : "none");
  }

  /** Nobody can be asked any more. */
  lost(): void {
    this.holder = null;
    this.become("none");
  }

  use(topology: Topology): void {
    const surface = new Set(topology.triangles);
    this.skin = [...surface].map((node) => new Vector3().fromArray(topology.rest, 3 * node));
  }

  show(frame: Frame): void {
    this.frame = frame;
  }

  /** The server says who holds it. */
  told(holder: number | null): void {
    this.holder = holder;
    if (!this.drive) return;
    const before = this.hold;
    if (holder === this.client) {
      if (before === "asked") {
        this.become("mine");
        if (!this.stays) this.let();
      } else if (before === "free" || before === "other") {
        this.say({ type: "release" }); // nobody here wants it any more
      }
    } else {
      this.become(holder === null ? "free" : "other");
    }
  }

  /** Asks for the handle, where nobody has it; whether it is held or may come to be. */
  take(): boolean {
    this.stays = true;
    if (this.hold === "letting") {
      this.become("mine");
      this.wanted.position.copy(this.sent.position);
      return true;
    }
    if (this.hold === "free" && this.frame !== null && this.begin(this.frame)) {
      this.say({ type: "take" });
      this.become("asked");
    }
    return this.held;
  }

  /** Lets go as a hand does: the finger springs off the plane, then it is released. */
  let(): void {
    this.stays = false;
    if (this.hold !== "mine") return;
    if (!this.springs) {
      this.drop();
      return;
    }
    const depth = this.depthOf(this.wanted);
    if (depth > -CLEAR && this.ground.known) {
      this.wanted.position.addScaledVector(this.ground.normal, Math.max(depth, 0) + CLEAR);
    }
    this.become("letting");
  }

  /** Releases at once. */
  drop(): void {
    this.stays = false;
    if (!this.held && this.hold !== "letting") return;
    this.say({ type: "release" });
    this.become("free");
  }

  /** Wants another pose; one deeper than allowed is raised along the plane's normal. */
  want(position: Vector3, orientation: Quaternion): void {
    if (!this.held) return;
    this.wanted.position.copy(position);
    this.wanted.orientation.copy(orientation).normalize();
    const over = this.depthOf(this.wanted) - this.deepest * (this.virtual ? 4 : 1);
    if (over > 0) this.wanted.position.addScaledVector(this.ground.normal, over);
  }

  /** Where a move begins. */
  start(): Pose {
    return { position: this.wanted.position.clone(), orientation: this.wanted.orientation.clone() };
  }

  /** Sends the next pose. dt: since the last one [s]. */
  tick(dt: number): void {
    this.since += dt;
    if (this.hold === "asked" && this.since > ASKING) this.become("free");
    if (this.hold !== "mine" && this.hold !== "letting") return;
    const letting = this.hold === "letting";
    const before = this.sent.position.clone();
    const [rate, damping] = letting ? [SPRING, SPRING_DAMPING] : [FOLLOW, 1];
    for (let left = Math.min(dt, 0.1); left > 0; left -= STEP) {
      const h = Math.min(left, STEP);
      const pull = this.wanted.position.clone().sub(this.sent.position).multiplyScalar(rate * rate);
      this.velocity.addScaledVector(pull, h).divideScalar(1 + 2 * damping * rate * h);
      this.sent.position.addScaledVector(this.velocity, h);
    }
    this.sent.orientation.slerp(this.wanted.orientation, 1 - Math.exp(-FOLLOW * dt));
    const moved = before.distanceTo(this.sent.position) / Math.max(dt, 1e-3);
    this.speed += (moved - this.speed) * (1 - Math.exp(-dt / 0.1));
    const { position, orientation } = this.sent;
    this.send([...position.toArray(), ...orientation.toArray()]);
    const near = position.distanceTo(this.wanted.position) < ARRIVED && this.velocity.length() < 1e-3;
    if (letting && (near || this.since > LONGEST_RETURN)) this.drop();
  }

  /** How far the deepest point of the skin at rest would be below the plane [m]; negative above it. */
  depthOf({ position, orientation }: Pose): number {
    if (!this.ground.known || this.skin.length === 0) return -Infinity;
    const normal = this.ground.normal.clone().applyQuaternion(orientation.clone().invert());
    const lowest = this.skin.reduce((low, point) => Math.min(low, point.dot(normal)), Infinity);
    return -(lowest + this.ground.height(position));
  }

  private get virtual(): boolean {
    return this.frame !== null && (this.frame.flags & VIRTUAL) !== 0;
  }

  /** Begins where the finger is commanded to be, which keeps it from jumping; false: nobody knows where that is. */
  private begin(frame: Frame): boolean {
    const pose = (frame.flags & COMMAND_KNOWN) !== 0 ? frame.command : frame.pose;
    if (!pose.every(Number.isFinite)) return false;
    for (const part of [this.wanted, this.sent]) {
      part.position.fromArray(pose);
      part.orientation.fromArray(pose, 3);
    }
    this.velocity.set(0, 0, 0);
    this.speed = 0;
    return true;
  }

  private become(hold: Hold): void {
    if (this.hold === hold) return;
    this.hold = hold;
    this.since = 0;
    this.changed();
  }
}
