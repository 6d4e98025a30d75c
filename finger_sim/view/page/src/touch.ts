/** How the finger touches the plane: nodes that stick and that slip, the force at each, and the wrench of all. */

import {
  CircleGeometry,
  DoubleSide,
  Group,
  InstancedMesh,
  Matrix4,
  MeshBasicMaterial,
  Quaternion,
  RingGeometry,
  Vector3,
  type BufferGeometry,
  type Camera,
} from "three";
import { Arrows, Turn } from "./arrows";
import { roundUp } from "./colours";
import type { Ground } from "./ground";
import { colour } from "./theme";
import type { Frame } from "./wire";

const LONGEST_ARROW = 0.011; // m, of a node's force
const WRENCH_SCALE = 0.003; // m/N
const LONGEST_WRENCH = 0.026; // m
const TURN_SCALE = 0.25; // rad in 1 mN m
const MARK = 4.2e-4; // m
const MANY = 70; // nodes; from so many on marks are smaller

/** A node in contact, and the friction on it. */
interface Mark {
  at: Vector3;
  pull: Vector3;
}

export class Touch {
  readonly group = new Group();
  readonly forces = new Group();
  /** What the longest arrow of a node stands for [N]. */
  arrowForce = 0.5;
  sticking = 0;
  slipping = 0;
  /** Where the wrench's arrow ends; null: there is no contact. */
  label: Vector3 | null = null;
  private readonly arrows = new Arrows(2.4e-4, true);
  private readonly wrench = new Arrows(5e-4, true, 1);
  private readonly turn = new Turn();
  private small = 1; // of the size of marks and arrows
  private readonly places = { sticks: [] as Mark[], slips: [] as Mark[] };
  private sticks: InstancedMesh;
  private slips: InstancedMesh;

  constructor(private readonly ground: Ground) {
    this.sticks = marks(new CircleGeometry(MARK, 16));
    this.slips = marks(new RingGeometry(0.85 * MARK, 1.9 * MARK, 3));
    this.forces.add(this.arrows.group, this.wrench.group, this.turn.mesh);
    this.group.add(this.sticks, this.slips);
  }

  update(frame: Frame): void {
    const tails: Vector3[] = [];
    const reaches: Vector3[] = [];
    const { sticks, slips } = this.places;
    sticks.length = slips.length = 0;
    const largest = frame.contacts.reduce((most, { force }) => Math.max(most, Math.hypot(...force)), 0);
    if (largest > this.arrowForce || largest < 0.2 * this.arrowForce) this.arrowForce = Math.max(roundUp(largest), 0.1);
    for (const { node, force, slips: slipping } of frame.contacts) {
      if (3 * node + 2 >= frame.positions.length) continue;
      const tip = new Vector3().fromArray(frame.positions, 3 * node);
      const reach = new Vector3(...force).multiplyScalar(LONGEST_ARROW / this.arrowForce);
      tails.push(tip.clone().sub(reach));
      reaches.push(reach);
      (slipping ? slips : sticks).push({ at: tip, pull: reach.clone().projectOnPlane(this.ground.normal) });
    }
    this.small = Math.min(1, Math.sqrt(MANY / Math.max(tails.length, 1)));
    this.arrows.set(tails, reaches, this.small);
    [this.sticking, this.slipping] = [sticks.length, slips.length];
    this.showWrench(frame);
  }

  /** Turns the marks to the eye: of a node that slips, a triangle that points to where friction pulls it. */
  face(camera: Camera): void {
    const toView = camera.quaternion.clone().invert();
    const placed = ({ at, pull }: Mark): Matrix4 => {
      const seen = pull.clone().applyQuaternion(toView);
      const turn = new Quaternion().setFromAxisAngle(new Vector3(0, 0, 1), Math.atan2(seen.y, seen.x));
      return new Matrix4().compose(at, camera.quaternion.clone().multiply(turn), new Vector3().setScalar(this.small));
    };
    this.sticks = show(this.sticks, this.places.sticks.map(placed), this.group);
    this.slips = show(this.slips, this.places.slips.map(placed), this.group);
  }

  repaint(): void {
    (this.sticks.material as MeshBasicMaterial).color = colour("stick");
    (this.slips.material as MeshBasicMaterial).color = colour("slip");
    this.arrows.material.color = colour("force");
    this.wrench.material.color = colour("wrench");
    this.turn.mesh.material.color = colour("wrench");
  }

  private showWrench(frame: Frame): void {
    const there = Number.isFinite(frame.centre[0]);
    this.wrench.group.visible = there;
    this.label = null;
    if (!there) {
      this.turn.mesh.visible = false;
      return;
    }
    const [centre, force] = [frame.centre, frame.force].map((values) => new Vector3().fromArray(values));
    const reach = force.clone().multiplyScalar(WRENCH_SCALE).clampLength(1e-6, LONGEST_WRENCH);
    this.wrench.set([centre], [reach]);
    this.label = centre.clone().add(reach);
    this.turn.set(centre, this.ground.normal, TURN_SCALE * 1e3 * this.spin(frame), 0.006, 4e-4);
  }

  /** Torque about the normal through the centre of pressure [N m]. */
  spin(frame: Frame): number {
    if (!Number.isFinite(frame.centre[0])) return 0;
    const arm = new Vector3().fromArray(frame.centre).sub(new Vector3().fromArray(frame.pose));
    const moved = arm.cross(new Vector3().fromArray(frame.force));
    return new Vector3().fromArray(frame.torque).sub(moved).dot(this.ground.normal);
  }
}

function marks(geometry: BufferGeometry, capacity = 128): InstancedMesh {
  const material = new MeshBasicMaterial({ side: DoubleSide, depthTest: false, transparent: true });
  const mesh = new InstancedMesh(geometry, material, capacity);
  mesh.frustumCulled = false;
  mesh.renderOrder = 5;
  mesh.count = 0;
  return mesh;
}

/** Shows marks at these places; a larger mesh takes the place of one in which they have no room. */
function show(mesh: InstancedMesh, places: Matrix4[], group: Group): InstancedMesh {
  let shown = mesh;
  if (places.length > mesh.instanceMatrix.count) {
    shown = marks(mesh.geometry, 2 * places.length);
    shown.material = mesh.material;
    group.remove(mesh);
    group.add(shown);
    mesh.dispose();
  }
  places.forEach((place, k) => shown.setMatrixAt(k, place));
  shown.count = places.length;
  shown.instanceMatrix.needsUpdate = true;
  return shown;
}
