/** Force and depth over the last ten seconds. Lines differ in their dashes as well as in their colours. */

import uPlot from "uplot";
import { byId } from "./dom";
import { cssColour } from "./theme";
import { RESTART, type Frame, type Sample } from "./wire";

const SPAN = 10; // s
const INTERVAL = 66; // ms between two pictures of a plot
const HEAD = 26; // px above a plot

interface Line {
  key: Exclude<keyof Sample, "time">;
  colour: string;
  dash: number[];
}

const FORCES: Line[] = [
  { key: "normal", colour: "normal", dash: [] },
  { key: "tangential", colour: "tangential", dash: [7, 4] },
  { key: "device", colour: "device", dash: [2, 3] },
];
const DEPTHS: Line[] = [{ key: "depth", colour: "depth", dash: [] }];

export class Plots {
  private readonly force = new Plot(byId("force-plot"), FORCES, 1);
  private readonly depth = new Plot(byId("depth-plot"), DEPTHS, 0.5);
  private samples: Sample[] = [];
  private drawn = 0;
  private fresh = true;

  /** Adds what came with a frame. A step back in time, or a frame that says so, begins anew. */
  add({ samples, flags }: Frame): void {
    if ((flags & RESTART) !== 0) this.samples = [];
    for (const sample of samples) {
      const last = this.samples.at(-1);
      if (last !== undefined && (sample.time < last.time - 0.5 || sample.time > last.time + SPAN)) this.samples = [];
      else if (last !== undefined && sample.time <= last.time) continue;
      this.samples.push(sample);
    }
    const now = this.samples.at(-1)?.time ?? 0;
    const old = this.samples.findIndex(({ time }) => time >= now - SPAN - 0.2);
    if (old > 50) this.samples.splice(0, old);
    this.fresh ||= samples.length > 0;
  }

  clear(): void {
    this.samples = [];
    this.fresh = true;
  }

  repaint(): void {
    for (const plot of [this.force, this.depth]) plot.repaint();
  }

  /** Draws, where there is something new and the last time is long enough ago. */
  tick(now: number): void {
    if (!this.fresh || now - this.drawn < INTERVAL) return;
    this.drawn = now;
    this.fresh = false;
    for (const plot of [this.force, this.depth]) plot.draw(this.samples);
  }
}

class Plot {
  private readonly plot: uPlot;

  constructor(
    private readonly holder: HTMLElement,
    private readonly lines: Line[],
    private readonly least: number,
  ) {
    const axis = (size: number): uPlot.Axis => ({
      stroke: () => cssColour("muted"),
      grid: { stroke: () => cssColour("rule"), width: 1 },
      ticks: { show: false },
      font: '11px "Segoe UI", Roboto, "Liberation Sans", Arial, sans-serif',
      size,
      gap: 4,
    });
    this.plot = new uPlot(
      {
        ...this.size(),
        pxAlign: false,
        legend: { show: false },
        cursor: { show: false },
        select: { show: false, left: 0, top: 0, width: 0, height: 0 },
        padding: [6, 10, 0, 0],
        scales: {
          x: { time: false, range: () => [-SPAN, 0] },
          y: { range: (_, low, high) => [Math.min(low ?? 0, 0), Math.max(1.12 * (high ?? 0), this.least)] },
        },
        axes: [
          { ...axis(22), values: (_, at) => at.map((t) => (t === 0 ? "now" : `${t} s`)), space: 60 },
          { ...axis(34), space: 26 },
        ],
        series: [
          {},
          ...lines.map(({ colour, dash }) => ({ stroke: () => cssColour(colour), width: 1.7, dash, points: { show: false } })),
        ],
      },
      [[], ...lines.map(() => [])],
      holder,
    );
    new ResizeObserver(() => this.plot.setSize(this.size())).observe(holder);
  }

  draw(samples: Sample[]): void {
    const now = samples.at(-1)?.time ?? 0;
    this.plot.setData([samples.map(({ time }) => time - now), ...this.lines.map(({ key }) => samples.map((sample) => sample[key]))]);
  }

  repaint(): void {
    this.plot.redraw(false);
  }

  private size(): { width: number; height: number } {
    return { width: Math.max(this.holder.clientWidth, 80), height: Math.max(this.holder.clientHeight, HEAD + 30) };
  }
}
