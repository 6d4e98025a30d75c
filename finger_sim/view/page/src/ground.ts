/** The plane: a grid of 1 mm and 10 mm that fades out around the finger, and moves and tilts as the plane does. */

import { DoubleSide, Mesh, PlaneGeometry, Quaternion, ShaderMaterial, Vector2, Vector3 } from "three";
import { GRID_FRAGMENT, GRID_VERTEX } from "./shaders";
import { colour } from "./theme";
import { PLANE_KNOWN, type Frame } from "./wire";

const RADIUS = 0.12; // m

export class Ground {
  readonly mesh: Mesh<PlaneGeometry, ShaderMaterial>;
  readonly origin = new Vector3();
  readonly orientation = new Quaternion();
  readonly normal = new Vector3(0, 0, 1);
  known = false;

  constructor() {
    const material = new ShaderMaterial({
      vertexShader: GRID_VERTEX,
      fragmentShader: GRID_FRAGMENT,
      side: DoubleSide,
      transparent: true,
      depthWrite: false,
      uniforms: {
        shift: { value: new Vector2() },
        radius: { value: RADIUS },
        line: { value: colour("grid") },
        ground: { value: colour("plane") },
      },
    });
    this.mesh = new Mesh(new PlaneGeometry(2 * RADIUS, 2 * RADIUS), material);
    this.mesh.renderOrder = -1;
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
  }

  /** Follows the plane; the piece that is drawn stays under the finger. */
  update(frame: Frame): void {
    this.known = (frame.flags & PLANE_KNOWN) !== 0;
    this.mesh.visible = this.known;
    if (!this.known) return;
    this.origin.fromArray(frame.plane);
    this.orientation.fromArray(frame.plane, 3);
    this.normal.set(0, 0, 1).applyQuaternion(this.orientation);
    const finger = new Vector3().fromArray(Number.isFinite(frame.pose[0]) ? frame.pose : frame.positions).sub(this.origin);
    const local = finger.applyQuaternion(this.orientation.clone().invert());
    local.z = 0;
    (this.mesh.material.uniforms.shift.value as Vector2).set(local.x, local.y);
    this.mesh.quaternion.copy(this.orientation);
    this.mesh.position.copy(local.applyQuaternion(this.orientation).add(this.origin));
  }

  /** How far a point is above the plane [m]. */
  height(point: Vector3): number {
    return point.clone().sub(this.origin).dot(this.normal);
  }

  repaint(): void {
    this.mesh.material.uniforms.line.value = colour("grid");
    this.mesh.material.uniforms.ground.value = colour("plane");
  }
}
