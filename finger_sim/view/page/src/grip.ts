/** The pointer's grip on the finger: mouse, pen and touch move it in the view plane, along the normal, or turn it. */

import { Mesh, MeshBasicMaterial, Quaternion, Ray, Raycaster, TorusGeometry, Vector2, Vector3 } from "three";
import type { Handle } from "./handle";
import type { Stage } from "./stage";
import { colour } from "./theme";
import type { World } from "./world";

export type Drag = "move" | "press" | "turn";
/** roll: by the ring, about the line of sight. */
export type Doing = Drag | "roll" | "none";

const TURN = 0.008; // rad for a pixel
const RING = 84; // px, its radius, and
const RING_REACH = 14; // px to each side in which it is taken
const FLAT = 0.25; // where the normal is seen shorter than that, up and down on the screen stands for it

export class Grip {
  drag: Drag = "move";
  doing: Doing = "none";
  readonly ring: Mesh<TorusGeometry, MeshBasicMaterial>;
  private pointer = -1;
  private readonly from = new Vector2();
  private readonly grabbed = new Vector3();
  private base = { position: new Vector3(), orientation: new Quaternion() };

  constructor(
    private readonly stage: Stage,
    private readonly world: World,
    private readonly handle: Handle,
    private readonly stays: () => boolean,
    private readonly changed: () => void,
  ) {
    const material = new MeshBasicMaterial({ depthTest: false, transparent: true, opacity: 0.9 });
    this.ring = new Mesh(new TorusGeometry(1, 0.022, 8, 72), material);
    this.ring.renderOrder = 8;
    this.ring.visible = false;
    stage.scene.add(this.ring);
    const canvas = stage.canvas;
    // On the way down, before the controls of the view hear of it.
    canvas.parentElement!.addEventListener("pointerdown", (event) => this.down(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      canvas.addEventListener(name, (event) => this.up(event));
    }
  }

  repaint(): void {
    this.ring.material.color = colour("accent");
  }

  /** Shows the ring where it can be used, as large as ever on the screen. */
  beforeDrawing(): void {
    const frame = this.world.frame;
    const usable = ["free", "asked", "mine", "letting"].includes(this.handle.hold);
    this.ring.visible = this.drag === "turn" && usable && frame !== null;
    if (!this.ring.visible || frame === null) return;
    this.ring.position.fromArray(frame.pose);
    this.ring.quaternion.copy(this.stage.camera.quaternion);
    this.ring.scale.setScalar(RING * this.stage.metresPerPixel(this.ring.position));
  }

  private down(event: PointerEvent): void {
    if (event.target !== this.stage.canvas) return;
    this.stage.canvas.parentElement!.focus({ preventScroll: true });
    if (this.pointer !== -1) {
      event.stopPropagation(); // a second finger on the screen does not turn the view meanwhile
      return;
    }
    if (event.button !== 0 && event.button !== 2) return;
    const at = this.place(event);
    const onRing = this.ring.visible && this.meetsRing(at);
    const hit = onRing ? this.ring.position.clone() : (this.world.body?.skin.hit(this.ray(at)) ?? null);
    if (hit === null || this.world.frame === null || !this.handle.take()) return;
    event.stopPropagation();
    event.preventDefault();
    this.doing = onRing ? "roll" : event.button === 2 ? "turn" : event.shiftKey ? "press" : this.drag;
    this.pointer = event.pointerId;
    this.stage.canvas.setPointerCapture(event.pointerId);
    this.from.copy(at);
    this.grabbed.copy(hit);
    this.base = this.handle.start();
    this.changed();
  }

  private move(event: PointerEvent): void {
    const at = this.place(event);
    if (event.pointerId !== this.pointer) {
      this.hover(event, at);
      return;
    }
    const { position, orientation } = this.base;
    if (this.doing === "turn") {
      this.handle.want(position, this.turned(at.clone().sub(this.from), orientation));
    } else if (this.doing === "roll") {
      this.handle.want(position, this.rolled(at, orientation));
    } else {
      const shift = this.doing === "press" ? this.pressed(at) : this.shifted(at);
      this.handle.want(position.clone().add(shift), orientation);
    }
  }

  private up(event: PointerEvent): void {
    if (event.pointerId !== this.pointer) return;
    this.pointer = -1;
    this.doing = "none";
    if (!this.stays()) this.handle.let();
    this.changed();
  }

  private hover(event: PointerEvent, at: Vector2): void {
    if (event.pointerType === "touch" || event.buttons !== 0) return;
    const over = (this.ring.visible && this.meetsRing(at)) || this.world.body?.skin.hit(this.ray(at)) != null;
    const usable = over && this.world.frame !== null && this.handle.hold !== "other" && this.handle.hold !== "none";
    this.stage.canvas.style.cursor = usable ? "grab" : "default";
  }

  /** From where it was grabbed to under the pointer, in the plane of the view. */
  private shifted(at: Vector2): Vector3 {
    const scale = this.stage.metresPerPixel(this.grabbed);
    const right = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 0);
    const up = new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, 1);
    return right.multiplyScalar(scale * (at.x - this.from.x)).addScaledVector(up, -scale * (at.y - this.from.y));
  }

  /** Along the plane's normal, so far that the grabbed point stays beside the pointer. */
  private pressed(at: Vector2): Vector3 {
    const normal = this.world.ground.normal;
    const scale = this.stage.metresPerPixel(this.grabbed);
    const [a, b] = [this.grabbed, this.grabbed.clone().addScaledVector(normal, 0.01)].map((p) => this.stage.project(p));
    const moved = at.clone().sub(this.from);
    if (a === null || b === null) return new Vector3();
    const seen = b.sub(a).divideScalar(0.01); // px/m
    const long = seen.length() * scale > FLAT;
    const amount = long ? moved.dot(seen) / seen.lengthSq() : -moved.y * scale;
    return normal.clone().multiplyScalar(amount);
  }

  private turned(moved: Vector2, orientation: Quaternion): Quaternion {
    const [right, up] = [0, 1].map((k) => new Vector3().setFromMatrixColumn(this.stage.camera.matrixWorld, k));
    const sideways = new Quaternion().setFromAxisAngle(up, TURN * moved.x);
    const over = new Quaternion().setFromAxisAngle(right, TURN * moved.y);
    return sideways.multiply(over).multiply(orientation);
  }

  private rolled(at: Vector2, orientation: Quaternion): Quaternion {
    const centre = this.stage.project(this.ring.position);
    if (centre === null) return orientation;
    const [begin, end] = [this.from, at].map((p) => Math.atan2(p.y - centre.y, p.x - centre.x));
    const sight = this.stage.camera.getWorldDirection(new Vector3());
    return new Quaternion().setFromAxisAngle(sight, end - begin).multiply(orientation);
  }

  private meetsRing(at: Vector2): boolean {
    const centre = this.stage.project(this.ring.position);
    return centre !== null && Math.abs(centre.distanceTo(at) - RING) < RING_REACH;
  }

  private place(event: PointerEvent): Vector2 {
    const { left, top } = this.stage.canvas.getBoundingClientRect();
    return new Vector2(event.clientX - left, event.clientY - top);
  }

  private ray(at: Vector2): Ray {
    const caster = new Raycaster();
    const { x, y } = this.stage.size;
    caster.setFromCamera(new Vector2((2 * at.x) / x - 1, 1 - (2 * at.y) / y), this.stage.camera);
    return caster.ray;
  }
}
