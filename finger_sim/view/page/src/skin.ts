/** The finger's skin: its triangles, bent along the normals at their corners so that a coarse mesh looks round. */

import {
  BufferAttribute,
  BufferGeometry,
  CustomBlending,
  DataTexture,
  DoubleSide,
  DynamicDrawUsage,
  LinearFilter,
  Mesh,
  MinEquation,
  OneFactor,
  Ray,
  RGBAFormat,
  ShaderMaterial,
  Vector3,
} from "three";
import { rampColour } from "./colours";
import { SHADOW_FRAGMENT, SHADOW_VERTEX, SKIN_FRAGMENT, SKIN_VERTEX } from "./shaders";
import { colour, isDark } from "./theme";
import { BONE, NAIL, type Topology } from "./wire";

const BEND = 0.7; // of the way from a flat triangle to one that its normals bend
const CREASE = Math.cos((66 * Math.PI) / 180); // faces that meet at a sharper angle are shaded apart

export class Skin {
  readonly mesh: Mesh<BufferGeometry, ShaderMaterial>;
  readonly shadow: Mesh<BufferGeometry, ShaderMaterial>;
  private readonly parts: number; // into how many an edge is divided
  private readonly weights: Float32Array; // (vertices of a face, 3)
  private readonly neighbours: Int32Array[]; // of each corner: the faces that it is shaded with
  private readonly coarse: BufferAttribute;
  private readonly faceNormals: Float32Array;
  private readonly nodeNormals: Float32Array;
  private flat = false;

  constructor(private readonly topology: Topology) {
    const faces = topology.triangles.length / 3;
    this.parts = faces < 1500 ? 4 : faces < 6000 ? 2 : 1;
    this.weights = barycentric(this.parts);
    const each = this.weights.length / 3;
    this.faceNormals = new Float32Array(3 * faces);
    this.nodeNormals = new Float32Array(topology.rest.length);
    this.coarse = new BufferAttribute(new Float32Array(topology.rest), 3).setUsage(DynamicDrawUsage);
    this.findNormals(topology.rest);
    this.neighbours = this.corners(faces);
    const geometry = new BufferGeometry();
    for (const [name, size] of [["position", 3], ["normal", 3], ["value", 1]] as const) {
      const attribute = new BufferAttribute(new Float32Array(size * each * faces), size).setUsage(DynamicDrawUsage);
      geometry.setAttribute(name, attribute);
    }
    geometry.setAttribute("part", new BufferAttribute(this.partOfFaces(each), 1));
    geometry.setAttribute("rest", new BufferAttribute(this.spread(topology.rest, each), 3));
    geometry.setIndex(new BufferAttribute(indices(faces, this.parts), 1));
    this.mesh = new Mesh(geometry, skinMaterial());
    this.mesh.frustumCulled = false;
    const outline = new BufferGeometry();
    outline.setAttribute("position", this.coarse);
    outline.setIndex(new BufferAttribute(topology.triangles, 1));
    this.shadow = new Mesh(outline, shadowMaterial());
    this.shadow.frustumCulled = false;
    this.shadow.renderOrder = -2;
    this.update(topology.rest, new Float32Array(topology.rest.length / 3));
  }

  /** Positions of the nodes, for what is drawn of the tetrahedra. */
  get nodes(): BufferAttribute {
    return this.coarse;
  }

  /** Shows other places and values of the nodes. */
  update(positions: Float32Array, values: Float32Array): void {
    this.coarse.array.set(positions);
    this.coarse.needsUpdate = true;
    this.findNormals(positions);
    const { triangles } = this.topology;
    const geometry = this.mesh.geometry;
    const [place, normal, value] = ["position", "normal", "value"].map((name) => geometry.getAttribute(name) as BufferAttribute);
    const [xs, ns, vs] = [place.array, normal.array, value.array] as Float32Array[];
    const shading = new Float32Array(9);
    const bend = this.flat ? 0 : BEND;
    let at = 0;
    for (let f = 0; f < triangles.length; f += 3) {
      for (let c = 0; c < 3; c++) this.shadingNormal(f + c, shading, 3 * c);
      for (let w = 0; w < this.weights.length; w += 3, at++) {
        let [x, y, z, value] = [0, 0, 0, 0];
        for (let c = 0; c < 3; c++) {
          const [b, k] = [this.weights[w + c], triangles[f + c]];
          x += b * positions[3 * k];
          y += b * positions[3 * k + 1];
          z += b * positions[3 * k + 2];
          value += b * values[k];
        }
        let [bx, by, bz] = [0, 0, 0];
        for (let c = 0; c < 3; c++) {
          const [b, k] = [this.weights[w + c], 3 * triangles[f + c]];
          const [nx, ny, nz] = [this.nodeNormals[k], this.nodeNormals[k + 1], this.nodeNormals[k + 2]];
          const off = b * ((x - positions[k]) * nx + (y - positions[k + 1]) * ny + (z - positions[k + 2]) * nz);
          bx -= off * nx;
          by -= off * ny;
          bz -= off * nz;
        }
        xs[3 * at] = x + bend * bx;
        xs[3 * at + 1] = y + bend * by;
        xs[3 * at + 2] = z + bend * bz;
        for (let i = 0; i < 3; i++) {
          ns[3 * at + i] = this.weights[w] * shading[i] + this.weights[w + 1] * shading[3 + i] + this.weights[w + 2] * shading[6 + i];
        }
        vs[at] = value;
      }
    }
    for (const attribute of [place, normal, value]) attribute.needsUpdate = true;
  }

  /** seen through: so that what is inside shows. flat: the triangles as they are computed. */
  appear(seenThrough: boolean, flat: boolean): void {
    const { material } = this.mesh;
    this.flat = flat;
    material.transparent = seenThrough;
    material.depthWrite = !seenThrough;
    material.uniforms.opacity.value = seenThrough ? 0.3 : 1;
  }

  repaint(): void {
    const dark = isDark();
    this.shadow.material.uniforms.ground.value = colour("stage");
    this.shadow.material.uniforms.strength.value = dark ? 0.5 : 0.22;
    this.mesh.material.uniforms.ambient.value = colour("ambient");
  }

  /** Where a ray first meets the skin; null: nowhere. */
  hit(ray: Ray): Vector3 | null {
    const { triangles } = this.topology;
    const [a, b, c, at] = [new Vector3(), new Vector3(), new Vector3(), new Vector3()];
    let nearest = Infinity;
    let found: Vector3 | null = null;
    for (let f = 0; f < triangles.length; f += 3) {
      a.fromBufferAttribute(this.coarse, triangles[f]);
      b.fromBufferAttribute(this.coarse, triangles[f + 1]);
      c.fromBufferAttribute(this.coarse, triangles[f + 2]);
      if (ray.intersectTriangle(a, b, c, false, at) === null) continue;
      const distance = at.distanceToSquared(ray.origin);
      if (distance < nearest) [nearest, found] = [distance, at.clone()];
    }
    return found;
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.shadow.geometry.dispose();
  }

  private findNormals(x: Float32Array): void {
    const { triangles } = this.topology;
    this.nodeNormals.fill(0);
    for (let f = 0; f < triangles.length; f += 3) {
      const [a, b, c] = [3 * triangles[f], 3 * triangles[f + 1], 3 * triangles[f + 2]];
      const [ux, uy, uz] = [x[b] - x[a], x[b + 1] - x[a + 1], x[b + 2] - x[a + 2]];
      const [vx, vy, vz] = [x[c] - x[a], x[c + 1] - x[a + 1], x[c + 2] - x[a + 2]];
      const [nx, ny, nz] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
      this.faceNormals.set([nx, ny, nz], f);
      for (const k of [a, b, c]) {
        this.nodeNormals[k] += nx;
        this.nodeNormals[k + 1] += ny;
        this.nodeNormals[k + 2] += nz;
      }
    }
    for (let k = 0; k < this.nodeNormals.length; k += 3) normalise(this.nodeNormals, k);
  }

  private shadingNormal(corner: number, out: Float32Array, at: number): void {
    out[at] = out[at + 1] = out[at + 2] = 0;
    for (const face of this.neighbours[corner]) {
      for (let i = 0; i < 3; i++) out[at + i] += this.faceNormals[3 * face + i];
    }
    normalise(out, at);
  }

  /** Of each corner of each face, the faces around its node that meet it at no sharp edge. */
  private corners(faces: number): Int32Array[] {
    const { triangles } = this.topology;
    const around = new Map<number, number[]>();
    for (let corner = 0; corner < 3 * faces; corner++) {
      const node = triangles[corner];
      const list = around.get(node) ?? [];
      list.push(Math.floor(corner / 3));
      around.set(node, list);
    }
    const unit = new Float32Array(this.faceNormals);
    for (let f = 0; f < faces; f++) normalise(unit, 3 * f);
    return Array.from(triangles, (node, corner) => {
      const own = 3 * Math.floor(corner / 3);
      const smooth = around.get(node)!.filter((face) => [0, 1, 2].reduce((s, i) => s + unit[own + i] * unit[3 * face + i], 0) > CREASE);
      return Int32Array.from(smooth);
    });
  }

  private partOfFaces(each: number): Float32Array {
    const { triangles, flags } = this.topology;
    const part = new Float32Array((each * triangles.length) / 3);
    if (flags === null) return part;
    for (let f = 0; f < triangles.length / 3; f++) {
      const marks = [0, 1, 2].map((c) => flags[triangles[3 * f + c]]);
      const all = (mark: number): boolean => marks.every((marked) => (marked & mark) !== 0);
      part.fill(all(NAIL) ? 2 : all(BONE) ? 1 : 0, f * each, (f + 1) * each);
    }
    return part;
  }

  private spread(values: Float32Array, each: number): Float32Array {
    const { triangles } = this.topology;
    const out = new Float32Array(each * triangles.length);
    let at = 0;
    for (let f = 0; f < triangles.length; f += 3) {
      for (let w = 0; w < this.weights.length; w += 3) {
        for (let i = 0; i < 3; i++, at++) {
          for (let c = 0; c < 3; c++) out[at] += this.weights[w + c] * values[3 * triangles[f + c] + i];
        }
      }
    }
    return out;
  }
}

/** Weights of the three corners at the points of a face that is divided n times along each edge. */
function barycentric(n: number): Float32Array {
  const out: number[] = [];
  for (let i = 0; i <= n; i++) for (let j = 0; j <= n - i; j++) out.push(1 - (i + j) / n, j / n, i / n);
  return Float32Array.from(out);
}

function indices(faces: number, n: number): Uint32Array {
  const each = ((n + 1) * (n + 2)) / 2;
  const row = (i: number): number => i * (n + 1) - (i * (i - 1)) / 2;
  const one: number[] = [];
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n - i; j++) {
      one.push(row(i) + j, row(i) + j + 1, row(i + 1) + j);
      if (j < n - i - 1) one.push(row(i) + j + 1, row(i + 1) + j + 1, row(i + 1) + j);
    }
  }
  return Uint32Array.from({ length: faces * one.length }, (_, k) => Math.floor(k / one.length) * each + one[k % one.length]);
}

function normalise(values: Float32Array, at: number): void {
  const size = Math.hypot(values[at], values[at + 1], values[at + 2]) || 1;
  for (let i = 0; i < 3; i++) values[at + i] /= size;
}

function skinMaterial(): ShaderMaterial {
  const bytes = new Uint8Array(4 * 256);
  for (let k = 0; k < 256; k++) bytes.set([...rampColour(k / 255).map(Math.round), 255], 4 * k);
  const ramp = new DataTexture(bytes, 256, 1, RGBAFormat);
  ramp.minFilter = ramp.magFilter = LinearFilter;
  ramp.needsUpdate = true;
  return new ShaderMaterial({
    vertexShader: SKIN_VERTEX,
    fragmentShader: SKIN_FRAGMENT,
    side: DoubleSide,
    uniforms: {
      ramp: { value: ramp },
      opacity: { value: 1 },
      contour: { value: 0 },
      showBone: { value: 0 },
      showNail: { value: 1 },
      dim: { value: 0 },
      ambient: { value: colour("ambient") },
    },
  });
}

function shadowMaterial(): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: SHADOW_VERTEX,
    fragmentShader: SHADOW_FRAGMENT,
    side: DoubleSide,
    depthTest: false,
    depthWrite: false,
    transparent: false, // so that it is drawn before the skin, which then covers it
    blending: CustomBlending,
    blendEquation: MinEquation,
    blendSrc: OneFactor,
    blendDst: OneFactor,
    uniforms: {
      origin: { value: new Vector3() },
      up: { value: new Vector3(0, 0, 1) },
      ground: { value: colour("stage") },
      strength: { value: 0.3 },
    },
  });
}
