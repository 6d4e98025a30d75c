/** A gamepad as a poor man's device: sticks move and turn, a trigger presses, and it rumbles with the force. */

import { Quaternion, Vector3 } from "three";
import { tell } from "./dom";
import type { Handle } from "./handle";
import type { Stage } from "./stage";
import type { World } from "./world";

const DEAD = 0.14; // of a stick's way
const MOVE = 0.045; // m/s
const TURN = 1.4; // rad/s
const LIFT = 0.02; // m/s
const RUMBLE = 80; // ms between two
const STRONG = 8; // N, at which it rumbles as it can
const TAKE = 0; // buttons of the standard layout
const LET = 1;
const LIFTS = 6;
const PRESSES = 7;

interface Rumbling {
  playEffect(kind: string, how: { duration: number; strongMagnitude: number; weakMagnitude: number }): Promise<unknown>;
}

export class Pad {
  private rumbled = 0;
  private pressing = false;
  private floor = 0; // depth at which the trigger began [m]

  constructor(
    private readonly stage: Stage,
    private readonly world: World,
    private readonly handle: Handle,
    private readonly seen: (name: string | null) => void,
  ) {
    const look = (): void => this.seen(this.pad()?.id ?? null);
    window.addEventListener("gamepadconnected", look);
    window.addEventListener("gamepaddisconnected", look);
  }

  /** Reads the sticks, and rumbles. dt: since the last time [s]. */
  tick(dt: number): void {
    const pad = this.pad();
    if (pad === null) return;
    const button = (k: number): number => pad.buttons[k]?.value ?? 0;
    const [x, y, roll, pitch] = [0, 1, 2, 3].map((k) => steady(pad.axes[k] ?? 0));
    if (button(LET) > 0.5) this.handle.let();
    const busy = [x, y, roll, pitch].some((value) => value !== 0) || [TAKE, LIFTS, PRESSES].some((k) => button(k) > 0.05);
    if (busy && this.handle.take()) this.move(dt, x, y, roll, pitch, button(PRESSES), button(LIFTS));
    if (button(PRESSES) <= 0.05) this.pressing = false;
    this.rumble(pad);
  }

  private move(dt: number, x: number, y: number, roll: number, pitch: number, press: number, lift: number): void {
    const { position, orientation } = this.handle.start();
    const normal = this.world.ground.normal;
    const right = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0).projectOnPlane(normal).normalize();
    const away = normal.clone().cross(right);
    position.addScaledVector(right, MOVE * dt * x).addScaledVector(away, -MOVE * dt * y);
    position.addScaledVector(normal, LIFT * dt * (lift > 0.05 ? lift : 0));
    if (press > 0.05) {
      const depth = this.handle.depthOf({ position, orientation });
      if (!this.pressing) this.floor = depth;
      this.pressing = true;
      const wanted = this.floor + press * (this.handle.deepest - this.floor);
      if (Number.isFinite(depth)) position.addScaledVector(normal, depth - wanted);
    }
    const turn = new Quaternion().setFromAxisAngle(normal, -TURN * dt * roll);
    turn.multiply(new Quaternion().setFromAxisAngle(right, TURN * dt * pitch));
    this.handle.want(position, turn.multiply(orientation));
  }

  private rumble(pad: Gamepad): void {
    const now = performance.now();
    const frame = this.world.frame;
    const actuator = (pad as unknown as { vibrationActuator?: Rumbling }).vibrationActuator;
    if (actuator?.playEffect === undefined || frame === null || now - this.rumbled < RUMBLE) return;
    if (this.handle.hold !== "mine") return;
    const force = new Vector3().fromArray(frame.force);
    const normal = Math.max(force.dot(this.world.ground.normal), 0);
    const tangential = force.projectOnPlane(this.world.ground.normal).length();
    if (normal < 0.02) return;
    this.rumbled = now;
    const [strong, weak] = [normal, 2 * tangential].map((value) => Math.min(value / STRONG, 1));
    tell("rumble", strong.toFixed(3));
    actuator
      .playEffect("dual-rumble", { duration: 1.5 * RUMBLE, strongMagnitude: strong, weakMagnitude: weak })
      .catch(() => undefined); // a pad that cannot rumble still moves the finger
  }

  private pad(): Gamepad | null {
    return navigator.getGamepads?.().find((pad) => pad?.connected) ?? null;
  }
}

/** Nothing near the middle of a stick, from there on finer than linear. */
function steady(value: number): number {
  const size = Math.abs(value);
  return size < DEAD ? 0 : Math.sign(value) * ((size - DEAD) / (1 - DEAD)) ** 1.5;
}
