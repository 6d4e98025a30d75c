/** Arrows, many of one kind at once, and the arc of an arrow that turns. */

import {
  BufferAttribute,
  BufferGeometry,
  ConeGeometry,
  CylinderGeometry,
  DynamicDrawUsage,
  Group,
  InstancedMesh,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  Quaternion,
  Vector3,
} from "three";

const UP = new Vector3(0, 1, 0);

/** Arrows of one colour; thickness [m] is that of the shaft. */
export class Arrows {
  readonly group = new Group();
  readonly material: MeshBasicMaterial;
  private shafts: InstancedMesh;
  private heads: InstancedMesh;
  private readonly place = new Matrix4();
  private readonly turn = new Quaternion();

  constructor(
    private readonly thickness: number,
    seenThrough: boolean,
    private capacity = 64,
  ) {
    this.material = new MeshBasicMaterial({ depthTest: !seenThrough, transparent: seenThrough });
    [this.shafts, this.heads] = this.make();
  }

  /** Shows arrows from `tails` that reach so far, both in metres; thinner: a part of their thickness. */
  set(tails: Vector3[], reaches: Vector3[], thinner = 1): void {
    if (tails.length > this.capacity) {
      this.capacity = 2 * tails.length;
      this.group.remove(this.shafts, this.heads);
      for (const mesh of [this.shafts, this.heads]) mesh.dispose();
      [this.shafts, this.heads] = this.make();
    }
    tails.forEach((tail, k) => {
      const length = reaches[k].length();
      const direction = length > 1e-9 ? reaches[k].clone().divideScalar(length) : UP;
      const head = Math.min(5.5 * this.thickness * thinner, 0.55 * length);
      this.turn.setFromUnitVectors(UP, direction);
      const width = Math.min(thinner, length / (4 * this.thickness));
      this.place.compose(tail, this.turn, new Vector3(width, Math.max(length - head, 1e-9), width));
      this.shafts.setMatrixAt(k, this.place);
      this.place.compose(tail.clone().addScaledVector(direction, length - head), this.turn, new Vector3(width, head, width));
      this.heads.setMatrixAt(k, this.place);
    });
    for (const mesh of [this.shafts, this.heads]) {
      mesh.count = tails.length;
      mesh.instanceMatrix.needsUpdate = true;
    }
  }

  private make(): [InstancedMesh, InstancedMesh] {
    const shaft = new CylinderGeometry(this.thickness / 2, this.thickness / 2, 1, 8).translate(0, 0.5, 0);
    const head = new ConeGeometry(1.5 * this.thickness, 1, 12).translate(0, 0.5, 0);
    const meshes = [shaft, head].map((geometry) => {
      const mesh: InstancedMesh = new InstancedMesh(geometry, this.material, this.capacity);
      mesh.frustumCulled = false;
      mesh.count = 0;
      mesh.renderOrder = this.material.depthTest ? 1 : 6;
      return mesh;
    });
    this.group.add(...meshes);
    return [meshes[0], meshes[1]];
  }
}

const PIECES = 40;

/** An arrow around an axis, which opens wider with a larger torque. */
export class Turn {
  readonly mesh: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly places: BufferAttribute;

  constructor() {
    const geometry = new BufferGeometry();
    this.places = new BufferAttribute(new Float32Array(3 * (2 * (PIECES + 1) + 3)), 3).setUsage(DynamicDrawUsage);
    geometry.setAttribute("position", this.places);
    const index: number[] = [];
    for (let k = 0; k < PIECES; k++) index.push(2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 2, 2 * k + 1, 2 * k + 3);
    const head = 2 * (PIECES + 1);
    index.push(head, head + 1, head + 2);
    geometry.setIndex(index);
    this.mesh = new Mesh(geometry, new MeshBasicMaterial({ side: 2, depthTest: false, transparent: true }));
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = 6;
    this.mesh.visible = false;
  }

  /** Around `axis` through `centre`; angle [rad] signed, radius and width [m]. */
  set(centre: Vector3, axis: Vector3, angle: number, radius: number, width: number): void {
    const size = Math.min(Math.abs(angle), 5.6);
    this.mesh.visible = size > 0.12;
    if (!this.mesh.visible) return;
    const turn = new Quaternion().setFromUnitVectors(new Vector3(0, 0, 1), axis);
    const sign = Math.sign(angle);
    let at = 0;
    const put = (phase: number, r: number): void => {
      const point = new Vector3(r * Math.cos(phase), sign * r * Math.sin(phase), 0).applyQuaternion(turn).add(centre);
      point.toArray(this.places.array, at);
      at += 3;
    };
    const tip = Math.min((3.5 * width) / radius, size);
    const begin = -size / 2;
    for (let k = 0; k <= PIECES; k++) {
      const phase = begin + ((size - tip) * k) / PIECES;
      put(phase, radius - width / 2);
      put(phase, radius + width / 2);
    }
    put(begin + size - tip, radius - 1.6 * width);
    put(begin + size - tip, radius + 1.6 * width);
    put(begin + size, radius);
    this.places.needsUpdate = true;
  }
}
