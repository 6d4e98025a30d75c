/** What colour shows on the finger: three quantities, each with a scale of its own, and one ramp of colours. */

import { short } from "./dom";
import type { Frame, Topology } from "./wire";

export type Quantity = "strain" | "pressure" | "displacement";

/** Stops of the ramp from 0 to 1: pale skin, orange, red, violet; its lightness falls all the way. */
export const RAMP: readonly [number, number, number][] = [
  [243, 219, 196],
  [250, 190, 140],
  [244, 141, 94],
  [225, 89, 86],
  [181, 49, 110],
  [124, 30, 120],
  [66, 18, 92],
];

/** The colour at a place of the ramp, in 0…255. */
export function rampColour(place: number): [number, number, number] {
  const at = Math.min(Math.max(place, 0), 1) * (RAMP.length - 1);
  const k = Math.min(Math.floor(at), RAMP.length - 2);
  const part = at - k;
  return [0, 1, 2].map((c) => RAMP[k][c] + part * (RAMP[k + 1][c] - RAMP[k][c])) as [number, number, number];
}

/** A scale as the legend shows it: `top` is the quantity at the end of the ramp. */
export interface Scale {
  quantity: Quantity;
  title: string;
  unit: string;
  top: number;
  ticks: { place: number; text: string }[];
  most: number; // in the frame shown
  open: boolean; // whether more than `top` is shown in the last colour
}

const AT_LIMIT = 128; // of the byte that a frame holds
const LARGEST_STRAIN = 255 / AT_LIMIT;

/** Finds the value of every node, between 0 and 1, and the scale that it is on. */
export class Painter {
  quantity: Quantity = "strain";
  values: Float32Array = new Float32Array(0);
  private areas: Float32Array = new Float32Array(0);
  private readonly tops = { pressure: 5, displacement: 0.5 };

  constructor(private topology: Topology) {
    this.use(topology);
  }

  use(topology: Topology): void {
    this.topology = topology;
    const nodes = topology.rest.length / 3;
    this.values = new Float32Array(nodes);
    this.areas = nodeAreas(topology);
  }

  paint(frame: Frame): Scale {
    if (this.quantity === "strain") return this.strain(frame);
    return this.quantity === "pressure" ? this.pressure(frame) : this.displacement(frame);
  }

  private strain(frame: Frame): Scale {
    let most = 0;
    for (let k = 0; k < this.values.length; k++) {
      this.values[k] = frame.strain[k] / 255;
      most = Math.max(most, frame.strain[k]);
    }
    const ticks = [0, 0.5, 1, 1.5].map((value) => ({ place: value / LARGEST_STRAIN, text: value.toFixed(1) }));
    ticks[2].text = "1.0 limit";
    ticks.push({ place: 1, text: "≥ 2.0" });
    return { quantity: "strain", title: "Strain / limit", unit: "", top: LARGEST_STRAIN, ticks, most: most / AT_LIMIT, open: true };
  }

  private pressure(frame: Frame): Scale {
    this.values.fill(0);
    for (const { node, force } of frame.contacts) {
      if (node < this.values.length) this.values[node] = Math.hypot(...force) / this.areas[node] / 1e3;
    }
    return this.scaled("pressure", "Contact pressure", "kPa");
  }

  private displacement(frame: Frame): Scale {
    const { rest } = this.topology;
    const [px, py, pz, qx, qy, qz, qw] = frame.pose;
    for (let k = 0; k < this.values.length; k++) {
      const [x, y, z] = [rest[3 * k], rest[3 * k + 1], rest[3 * k + 2]];
      const [tx, ty, tz] = [2 * (qy * z - qz * y), 2 * (qz * x - qx * z), 2 * (qx * y - qy * x)];
      const dx = frame.positions[3 * k] - (px + x + qw * tx + qy * tz - qz * ty);
      const dy = frame.positions[3 * k + 1] - (py + y + qw * ty + qz * tx - qx * tz);
      const dz = frame.positions[3 * k + 2] - (pz + z + qw * tz + qx * ty - qy * tx);
      this.values[k] = 1e3 * Math.hypot(dx, dy, dz);
    }
    return this.scaled("displacement", "Displacement", "mm");
  }

  /** Values come to lie between 0 and 1 of a round number that grows at once and shrinks late. */
  private scaled(quantity: "pressure" | "displacement", title: string, unit: string): Scale {
    const most = this.values.reduce((a, b) => Math.max(a, b), 0);
    let top = this.tops[quantity];
    if (most > top || most < 0.15 * top) top = this.tops[quantity] = Math.max(roundUp(most), LEAST[quantity]);
    for (let k = 0; k < this.values.length; k++) this.values[k] /= top;
    const ticks = [0, 0.25, 0.5, 0.75, 1].map((place) => ({ place, text: short(place * top) }));
    return { quantity, title, unit, top, ticks, most, open: false };
  }
}

const LEAST = { pressure: 5, displacement: 0.5 };

/** The next of 1, 2, 5, 10, 20, … */
export function roundUp(value: number): number {
  if (!(value > 0)) return 0;
  const power = 10 ** Math.floor(Math.log10(value));
  const digit = value / power;
  return power * (digit <= 1 ? 1 : digit <= 2 ? 2 : digit <= 5 ? 5 : 10);
}

/** A third of the triangles around each node [m²]; of a node inside, so much that nothing divided by it shows. */
function nodeAreas({ rest, triangles }: Topology): Float32Array {
  const areas = new Float32Array(rest.length / 3);
  for (let f = 0; f < triangles.length; f += 3) {
    const [a, b, c] = [triangles[f], triangles[f + 1], triangles[f + 2]].map((k) => 3 * k);
    const u = [0, 1, 2].map((i) => rest[b + i] - rest[a + i]);
    const v = [0, 1, 2].map((i) => rest[c + i] - rest[a + i]);
    const cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const k of [a, b, c]) areas[k / 3] += Math.hypot(...cross) / 6;
  }
  return areas.map((area) => (area > 0 ? area : 1));
}
