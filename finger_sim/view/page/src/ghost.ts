/** Where the finger is commanded to be, and the spring that pulls it there, under a virtual coupling. */

import {
  BufferAttribute,
  BufferGeometry,
  DynamicDrawUsage,
  EdgesGeometry,
  Group,
  Line,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  Quaternion,
  Vector3,
} from "three";
import { colour } from "./theme";
import { COMMAND_KNOWN, VIRTUAL, type Frame, type Topology } from "./wire";

const COILS = 7;
const POINTS = 16 * COILS + 3;
const WIDTH = 0.0014; // m, radius of the coils
const NEAR = 1e-5; // m: no spring is drawn that is shorter

export class Ghost {
  readonly group = new Group();
  private readonly body = new Group();
  private readonly edges: LineSegments<EdgesGeometry, LineBasicMaterial>;
  private readonly fill: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly spring: Line<BufferGeometry, LineBasicMaterial>;

  constructor(topology: Topology) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(topology.rest, 3));
    geometry.setIndex(new BufferAttribute(topology.triangles, 1));
    this.edges = new LineSegments(new EdgesGeometry(geometry, 12), new LineBasicMaterial({ transparent: true, opacity: 0.75 }));
    this.fill = new Mesh(geometry, new MeshBasicMaterial({ transparent: true, opacity: 0.12, depthWrite: false }));
    this.edges.renderOrder = this.fill.renderOrder = 3;
    this.body.add(this.fill, this.edges);
    const coil = new BufferGeometry();
    coil.setAttribute("position", new BufferAttribute(new Float32Array(3 * POINTS), 3).setUsage(DynamicDrawUsage));
    this.spring = new Line(coil, new LineBasicMaterial({ depthTest: false, transparent: true }));
    this.spring.renderOrder = 7;
    this.spring.frustumCulled = false;
    this.group.add(this.body, this.spring);
    this.group.visible = false;
  }

  /** always: also where the finger follows its command without a spring. */
  update(frame: Frame, always: boolean): void {
    const virtual = (frame.flags & VIRTUAL) !== 0;
    this.group.visible = (frame.flags & COMMAND_KNOWN) !== 0 && (virtual || always);
    if (!this.group.visible) return;
    this.body.position.fromArray(frame.command);
    this.body.quaternion.fromArray(frame.command, 3);
    const [from, to] = [frame.pose, frame.command].map((pose) => new Vector3().fromArray(pose));
    this.spring.visible = virtual && from.distanceTo(to) > NEAR;
    if (this.spring.visible) this.coil(from, to);
  }

  repaint(): void {
    for (const { material } of [this.edges, this.fill, this.spring]) material.color = colour("ghost");
  }

  private coil(from: Vector3, to: Vector3): void {
    const places = this.spring.geometry.getAttribute("position") as BufferAttribute;
    const along = to.clone().sub(from);
    const turn = new Quaternion().setFromUnitVectors(new Vector3(0, 0, 1), along.clone().normalize());
    for (let k = 0; k < POINTS; k++) {
      const part = k / (POINTS - 1);
      const radius = WIDTH * Math.min(1, 8 * part, 8 * (1 - part));
      const phase = 2 * Math.PI * COILS * part;
      const off = new Vector3(radius * Math.cos(phase), radius * Math.sin(phase), 0).applyQuaternion(turn);
      const point = from.clone().addScaledVector(along, part).add(off);
      places.setXYZ(k, point.x, point.y, point.z);
    }
    places.needsUpdate = true;
  }
}
