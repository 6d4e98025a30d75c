/** Where things are drawn: scene, camera and renderer. A picture is made only where something changed. */

import { ColorManagement, LinearSRGBColorSpace, PerspectiveCamera, Quaternion, Scene, Vector2, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { colour } from "./theme";

ColorManagement.enabled = false;

export type Looking = "reset" | "side" | "front" | "below";

/** Directions from what is looked at to the eye, in the plane's axes: z is the normal. */
const EYES: Record<Looking, [number, number, number]> = {
  reset: [0.62, -0.92, 0.42],
  side: [0.02, -1, 0.09],
  front: [1, -0.04, 0.16],
  below: [0.25, -0.35, -1],
};
const DISTANCE = 0.104; // m
const ORBIT = 1.6; // rad/s of the keys
const PAN = 0.05; // m/s
const ZOOM = 1.6; // times in a second

export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(30, 1, 0.002, 4);
  readonly canvas: HTMLCanvasElement;
  readonly controls: OrbitControls;
  readonly size = new Vector2(1, 1);
  private readonly renderer: WebGLRenderer;
  private dirty = true;
  private readonly axis = new Vector3(0, 0, 1);

  /** Throws where the browser has no WebGL. */
  constructor(private readonly holder: HTMLElement) {
    this.renderer = new WebGLRenderer({ antialias: window.devicePixelRatio >= 1, alpha: false, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.sortObjects = true;
    this.canvas = this.renderer.domElement;
    this.canvas.setAttribute("aria-hidden", "true");
    holder.prepend(this.canvas);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = false;
    this.controls.minDistance = 0.01;
    this.controls.maxDistance = 1.2;
    this.controls.zoomSpeed = 1.2;
    this.controls.addEventListener("change", () => this.request());
    this.canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => this.request());
    new ResizeObserver(() => this.resize()).observe(holder);
    this.resize();
  }

  request(): void {
    this.dirty = true;
  }

  /** Draws, where something was asked for since the last time; whether it did. */
  draw(): boolean {
    if (!this.dirty) return false;
    this.dirty = false;
    this.renderer.render(this.scene, this.camera);
    return true;
  }

  repaint(): void {
    this.renderer.setClearColor(colour("stage"), 1);
    this.request();
  }

  /** Looks at a point from one of the known sides. */
  look(from: Looking, at: Vector3, plane: Quaternion): void {
    const narrow = Math.max(1, 1.6 / this.camera.aspect);
    const eye = new Vector3(...EYES[from]).normalize().multiplyScalar(DISTANCE * narrow).applyQuaternion(plane);
    this.controls.target.copy(at);
    this.camera.position.copy(at).add(eye);
    this.controls.update();
    this.request();
  }

  /** Turns, shifts and scales the view as keys ask for: each of -1, 0, 1. */
  steer(dt: number, turn: [number, number], pan: [number, number], zoom: number): void {
    const eye = this.camera.position.clone().sub(this.controls.target);
    const right = new Vector3().setFromMatrixColumn(this.camera.matrix, 0);
    const up = new Vector3().setFromMatrixColumn(this.camera.matrix, 1);
    eye.applyAxisAngle(this.axis, ORBIT * dt * turn[0]);
    const tilted = eye.clone().applyAxisAngle(right, ORBIT * dt * turn[1]);
    if (Math.abs(tilted.angleTo(this.axis) - Math.PI / 2) < Math.PI / 2 - 0.05) eye.copy(tilted);
    eye.multiplyScalar(ZOOM ** (-dt * zoom));
    eye.clampLength(this.controls.minDistance, this.controls.maxDistance);
    const shift = right.multiplyScalar(PAN * dt * pan[0]).addScaledVector(up, PAN * dt * pan[1]);
    this.controls.target.add(shift);
    this.camera.position.copy(this.controls.target).add(eye);
    this.controls.update();
    this.request();
  }

  /** Where a point of the world is on the canvas, in CSS pixels; null: behind the eye. */
  project(point: Vector3): Vector2 | null {
    const at = point.clone().project(this.camera);
    if (at.z > 1) return null;
    return new Vector2((0.5 + 0.5 * at.x) * this.size.x, (0.5 - 0.5 * at.y) * this.size.y);
  }

  /** Metres in a CSS pixel at a point of the world. */
  metresPerPixel(point: Vector3): number {
    const forward = this.camera.getWorldDirection(new Vector3());
    const depth = Math.max(point.clone().sub(this.camera.position).dot(forward), 1e-3);
    return (2 * depth * Math.tan((this.camera.fov * Math.PI) / 360)) / this.size.y;
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.holder;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.size.set(clientWidth, clientHeight);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(clientWidth, clientHeight);
    this.request();
  }
}
