/** The keyboard: everything that a pointer can do with finger and view. */

import { Quaternion, Vector3 } from "three";
import type { Handle } from "./handle";
import type { Stage } from "./stage";
import type { World } from "./world";

const MOVE = 0.02; // m/s
const PRESS = 0.004; // m/s
const TURN = 0.7; // rad/s
const TAP = 0.06; // s that the shortest press of a key counts for

const FINGER = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "PageUp", "PageDown"]);
const VIEW = new Set(["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE", "Equal", "Minus", "NumpadAdd", "NumpadSubtract"]);

interface Commands {
  reset(): void;
  pause(): void;
  resetView(): void;
  help(): void;
}

export class Keys {
  private readonly down = new Map<string, number>(); // the time left that a key counts for; Infinity while it is down
  private shift = false;

  constructor(
    viewport: HTMLElement,
    private readonly stage: Stage,
    private readonly world: World,
    private readonly handle: Handle,
    private readonly commands: Commands,
  ) {
    document.addEventListener("keydown", (event) => this.pressed(event, viewport));
    document.addEventListener("keyup", (event) => this.raised(event));
    window.addEventListener("blur", () => this.down.clear());
  }

  /** Moves what the keys that are down ask for. dt: since the last time [s]. */
  tick(dt: number): void {
    if (this.down.size === 0) return;
    const on = (...codes: string[]): number => Number(codes.some((code) => this.down.has(code)));
    this.moveFinger(dt, on);
    const turn: [number, number] = [on("KeyD") - on("KeyA"), on("KeyS") - on("KeyW")];
    const zoom = on("KeyE", "Equal", "NumpadAdd") - on("KeyQ", "Minus", "NumpadSubtract");
    if (turn[0] !== 0 || turn[1] !== 0 || zoom !== 0) {
      const still: [number, number] = [0, 0];
      this.stage.steer(dt, this.shift ? still : turn, this.shift ? [turn[0], -turn[1]] : still, zoom);
    }
    for (const [code, left] of this.down) {
      if (left <= dt) this.down.delete(code);
      else this.down.set(code, left - dt);
    }
  }

  private moveFinger(dt: number, on: (...codes: string[]) => number): void {
    const [x, y] = [on("ArrowRight") - on("ArrowLeft"), on("ArrowUp") - on("ArrowDown")];
    const z = on("PageUp") - on("PageDown");
    if ((x === 0 && y === 0 && z === 0) || !this.handle.take()) return;
    const normal = this.world.ground.known ? this.world.ground.normal : new Vector3(0, 0, 1);
    const { position, orientation } = this.handle.start();
    const right = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0).projectOnPlane(normal).normalize();
    const away = normal.clone().cross(right);
    if (this.shift) {
      const axis = away.clone().multiplyScalar(x).addScaledVector(right, -y).addScaledVector(normal, z);
      const turn = new Quaternion().setFromAxisAngle(axis.clone().normalize(), TURN * dt);
      this.handle.want(position, turn.multiply(orientation));
    } else {
      position.addScaledVector(right, MOVE * dt * x).addScaledVector(away, MOVE * dt * y);
      this.handle.want(position.addScaledVector(normal, PRESS * dt * z), orientation);
    }
  }

  private pressed(event: KeyboardEvent, viewport: HTMLElement): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    this.shift = event.shiftKey;
    const target = event.target instanceof HTMLElement ? event.target : document.body;
    const inView = target === viewport || target === document.body;
    if (target.closest("input, select, textarea, dialog") !== null) return;
    if (inView && (FINGER.has(event.code) || VIEW.has(event.code))) {
      this.down.set(event.code, Infinity);
    } else if (inView && event.code === "Escape") {
      this.down.clear(); // a key that still counts would take it again
      this.handle.let();
    } else if (inView && event.code === "Enter") {
      this.handle.take();
    } else if (inView && (event.code === "Home" || event.code === "Digit0")) {
      this.commands.resetView();
    } else if (event.code === "KeyR" && !event.repeat) {
      this.commands.reset();
    } else if (event.code === "Space" && target.closest("button, summary, a") === null) {
      if (!event.repeat) this.commands.pause();
    } else if (event.key === "?") {
      this.commands.help();
    } else {
      return;
    }
    event.preventDefault();
  }

  private raised(event: KeyboardEvent): void {
    this.shift = event.shiftKey;
    if (this.down.has(event.code)) this.down.set(event.code, TAP);
  }
}
