/** What lies inside the finger: the edges of its tetrahedra, and the axes along which their strain is limited. */

import { BufferAttribute, BufferGeometry, DynamicDrawUsage, Group, LineBasicMaterial, LineSegments } from "three";
import { colour } from "./theme";
import type { Topology } from "./wire";

const EDGES = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]; // prettier-ignore

/** Edges of all tetrahedra, or of the triangles where no tetrahedra are known. */
export class Wireframe {
  readonly lines: LineSegments<BufferGeometry, LineBasicMaterial>;

  /** nodes: positions, which somebody else keeps up to date. */
  constructor(topology: Topology, nodes: BufferAttribute) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", nodes);
    geometry.setIndex(new BufferAttribute(edges(topology), 1));
    this.lines = new LineSegments(geometry, new LineBasicMaterial({ transparent: true, opacity: 0.55 }));
    this.lines.frustumCulled = false;
    this.lines.visible = false;
  }

  repaint(): void {
    this.lines.material.color = colour("wire");
  }
}

function edges({ tets, triangles }: Topology): Uint32Array {
  const seen = new Set<number>();
  const nodes: number[] = [];
  const add = (a: number, b: number): void => {
    const key = Math.min(a, b) * 2 ** 24 + Math.max(a, b);
    if (seen.has(key)) return;
    seen.add(key);
    nodes.push(a, b);
  };
  for (let t = 0; t < tets.length; t += 4) for (const [i, j] of EDGES) add(tets[t + i], tets[t + j]);
  if (tets.length === 0) {
    for (let f = 0; f < triangles.length; f += 3) for (let c = 0; c < 3; c++) add(triangles[f + c], triangles[f + ((c + 1) % 3)]);
  }
  return Uint32Array.from(nodes);
}

/** How each axis is drawn, as parts of its length: a line, two dashes, four dots. Colour alone does not tell them. */
const DASHES = [
  [[-1, 1]],
  [[-1, -0.25], [0.25, 1]],
  [[-1, -0.72], [-0.43, -0.14], [0.14, 0.43], [0.72, 1]],
]; // prettier-ignore
const LENGTH = 0.3; // of the size of a tetrahedron, to each side

/** e1 e2 e3 of each tetrahedron, as they are carried along by the body. */
export class LimitAxes {
  readonly group = new Group();
  private readonly lines: LineSegments<BufferGeometry, LineBasicMaterial>[];
  private readonly inverse: Float32Array; // of each tetrahedron's edges at rest (3, 3)
  private readonly size: Float32Array;

  constructor(private readonly topology: Topology) {
    const { tets, rest } = topology;
    const count = topology.axes === null ? 0 : tets.length / 4;
    this.inverse = new Float32Array(9 * count);
    this.size = new Float32Array(count);
    for (let t = 0; t < count; t++) {
      const d = edgesOf(tets, rest, t);
      this.size[t] = LENGTH * Math.cbrt(Math.abs(invert(d, this.inverse, 9 * t)));
    }
    this.lines = DASHES.map((dashes) => {
      const geometry = new BufferGeometry();
      const places = new Float32Array(6 * dashes.length * count);
      geometry.setAttribute("position", new BufferAttribute(places, 3).setUsage(DynamicDrawUsage));
      const drawn = new LineSegments(geometry, new LineBasicMaterial());
      drawn.frustumCulled = false;
      return drawn;
    });
    this.group.add(...this.lines);
    this.group.visible = false;
  }

  get known(): boolean {
    return this.topology.axes !== null && this.topology.tets.length > 0;
  }

  /** Follows the body, where the axes are shown at all. */
  update(x: Float32Array): void {
    const { tets, axes } = this.topology;
    if (!this.group.visible || axes === null) return;
    const outs = this.lines.map((lines) => lines.geometry.getAttribute("position").array as Float32Array);
    const at = [0, 0, 0];
    for (let t = 0; t < this.size.length; t++) {
      const d = edgesOf(tets, x, t);
      const centre = [0, 1, 2].map((i) => 0.25 * [0, 1, 2, 3].reduce((sum, c) => sum + x[3 * tets[4 * t + c] + i], 0));
      for (let k = 0; k < 3; k++) {
        const e = axes.subarray(9 * t + 3 * k, 9 * t + 3 * k + 3);
        const local = [0, 1, 2].map((i) => [0, 1, 2].reduce((sum, j) => sum + this.inverse[9 * t + 3 * i + j] * e[j], 0));
        const carried = [0, 1, 2].map((i) => this.size[t] * [0, 1, 2].reduce((sum, c) => sum + d[3 * i + c] * local[c], 0));
        for (const dash of DASHES[k]) {
          for (const end of dash) for (let i = 0; i < 3; i++) outs[k][at[k]++] = centre[i] + end * carried[i];
        }
      }
    }
    for (const lines of this.lines) lines.geometry.getAttribute("position").needsUpdate = true;
  }

  repaint(): void {
    this.lines.forEach((lines, k) => (lines.material.color = colour(`axis${k + 1}`)));
  }
}

/** Edges from the last corner of a tetrahedron, in columns. */
function edgesOf(tets: Uint32Array, x: Float32Array, t: number): number[] {
  const corner = (c: number, i: number): number => x[3 * tets[4 * t + c] + i];
  return Array.from({ length: 9 }, (_, k) => corner(k % 3, Math.floor(k / 3)) - corner(3, Math.floor(k / 3)));
}

/** Writes the inverse of a matrix in rows; its determinant. */
function invert(m: number[], out: Float32Array, at: number): number {
  const [a, b, c, d, e, f, g, h, i] = m;
  const [p, q, r] = [e * i - f * h, f * g - d * i, d * h - e * g];
  const det = a * p + b * q + c * r;
  const inverse = [p, c * h - b * i, b * f - c * e, q, a * i - c * g, c * d - a * f, r, b * g - a * h, a * e - b * d];
  inverse.forEach((value, k) => (out[at + k] = value / det));
  return det;
}
