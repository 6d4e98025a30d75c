/** The panel of parameters: what is often used on top, everything else in groups, and a filter over all. */

import { byId, make, sparsely, write } from "./dom";
import { control, ownSlider, type Control } from "./fields";
import type { Item, Status, Value } from "./wire";

/** Shown on top, in this order and by these names, where the scene has them. */
const OFTEN: Record<string, string> = {
  "plane.friction": "Friction μ",
  "limits.stiffness": "Limit stiffness",
  "coupling.stiffness": "Coupling stiffness",
  "solver.level": "Solver level",
  "solver.budget_ms": "Step budget",
  force_scale: "Force scale",
};
const POINT = "plane.point";
const NORMAL = "plane.normal";
const SENT = 80; // ms between two values of a slider that moves
const ANSWERED = 1500; // ms after which a value that was not taken is put back

type Send = (name: string, value: Value) => void;

export class Panel {
  private readonly groups = byId("groups");
  private readonly filter = byId<HTMLInputElement>("filter");
  private controls = new Map<string, Control[]>();
  private values = new Map<string, Value>();
  private senders = new Map<string, (value: Value) => void>();
  private pending = new Map<string, number>();
  private wanted = new Map<string, Value>(); // until the server says what holds
  private cost: HTMLElement | null = null;
  private readonly open = new Set(["often"]);

  constructor(private readonly send: Send) {
    this.filter.addEventListener("input", () => this.sift());
    this.filter.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      this.filter.value = "";
      this.sift();
    });
  }

  /** Shows these parameters, and forgets those before. */
  use(items: Item[]): void {
    this.controls.clear();
    this.senders.clear();
    this.cost = null;
    this.values = new Map(items.map((item) => [item.name, item.value]));
    const often = Object.keys(OFTEN).map((name) => items.find((item) => item.name === name)).filter((item) => item?.live) as Item[];
    const names = [...new Set(items.map((item) => item.group))];
    const parts = [this.group("often", "Often used", [...often.map((item) => this.add(item, OFTEN[item.name])), ...this.planeSliders(items)])];
    for (const name of names) {
      const inside = items.filter((item) => item.group === name).map((item) => this.add(item));
      parts.push(this.group(name, title(name), inside));
    }
    this.groups.replaceChildren(...parts);
    byId("parameters").hidden = items.length === 0;
    for (const [name, value] of this.values) this.show(name, value);
    this.sift();
  }

  /** Somebody, here or elsewhere, has changed values. */
  told(values: Record<string, Value>): void {
    for (const [name, value] of Object.entries(values)) {
      window.clearTimeout(this.pending.get(name));
      this.pending.delete(name);
      this.wanted.delete(name);
      this.values.set(name, value);
      this.show(name, value);
    }
  }

  /** What the level costs and gives up, right beside it. */
  status(status: Status): void {
    if (this.cost === null) return;
    const level = String(this.values.get("solver.level") ?? "");
    const { p50, p99 } = status.step_ms ?? { p50: null, p99: null };
    const time = p50 === null ? "step time not known" : `step ${p50.toFixed(2)} ms${p99 === null ? "" : `, p99 ${p99.toFixed(2)} ms`}`;
    const error = status.level_errors?.[level];
    const parts = [time, error === undefined ? "force error not measured for this scene" : `force error ${error}`];
    if (status.accuracy !== null) parts.push(`budget: ${status.accuracy}`);
    write(this.cost, parts.join(" · "));
  }

  /** Without a live server nothing can be set, and no cost is known. */
  live(on: boolean): void {
    byId("parameters").toggleAttribute("inert", !on);
    if (!on && this.cost !== null) write(this.cost, "step time not known");
  }

  private add(item: Item, name?: string): HTMLElement {
    const send = (value: Value): void => this.want(item.name, value);
    const made = control(item, send, name);
    this.register(item.name, made);
    if (item.name === "solver.level" && this.cost === null) {
      this.cost = make("p", { className: "cost", id: "cost" }, "step time not known");
      made.element.append(this.cost);
    }
    return made.element;
  }

  private register(name: string, made: Control): void {
    this.controls.set(name, [...(this.controls.get(name) ?? []), made]);
  }

  /** Height and tilt of the plane, of which the scene has a point and a normal. */
  private planeSliders(items: Item[]): HTMLElement[] {
    const [point, normal] = [POINT, NORMAL].map((name) => items.find((item) => item.name === name && item.live));
    if (point === undefined || normal === undefined) return [];
    const now = (name: string): number[] => (this.wanted.get(name) ?? this.values.get(name) ?? [0, 0, 1]) as number[];
    const height = ownSlider("Plane height", "mm", "Height of the plane's point above the world's origin. (plane.point)", [-15, 15], 0.1, (mm) => {
      const [x, y] = now(POINT);
      this.want(POINT, [x, y, mm / 1e3]);
    });
    const tilt = (k: 0 | 1): Control => {
      const name = k === 0 ? "Plane tilt about x" : "Plane tilt about y";
      return ownSlider(name, "°", "Turn of the plane's normal out of the vertical. (plane.normal)", [-45, 45], 0.5, (degrees) => {
        const angles = tilts(now(NORMAL));
        angles[k] = (degrees * Math.PI) / 180;
        this.want(NORMAL, tilted(angles));
      });
    };
    const [about, over] = [tilt(0), tilt(1)];
    this.register(POINT, { element: height.element, show: (value) => height.show(1e3 * ((value as number[])[2] ?? 0)) });
    [about, over].forEach((made, k) =>
      this.register(NORMAL, {
        element: made.element,
        show: (value) => made.show((tilts(value as number[])[k] * 180) / Math.PI),
      }),
    );
    return [height.element, about.element, over.element];
  }

  /** Sends a value, not too often; what is not taken is put back. */
  private want(name: string, value: Value): void {
    this.wanted.set(name, value);
    let send = this.senders.get(name);
    if (send === undefined) {
      send = sparsely(SENT, (wanted: Value) => this.send(name, wanted));
      this.senders.set(name, send);
    }
    send(value);
    window.clearTimeout(this.pending.get(name));
    this.pending.set(
      name,
      window.setTimeout(() => {
        this.wanted.delete(name);
        this.show(name, this.values.get(name) ?? null);
      }, ANSWERED),
    );
  }

  private show(name: string, value: Value): void {
    for (const shown of this.controls.get(name) ?? []) shown.show(value);
  }

  private group(key: string, name: string, inside: HTMLElement[]): HTMLElement {
    const body = make("div", { className: "fields" }, ...inside);
    const summary = make("summary", {}, name, make("span", { className: "count" }, String(inside.length)));
    const details = make("details", { className: "group", open: this.open.has(key) }, summary, body);
    details.dataset.group = key;
    details.hidden = inside.length === 0;
    details.addEventListener("toggle", () => {
      if (this.filter.value !== "") return;
      if (details.open) this.open.add(key);
      else this.open.delete(key);
    });
    return details;
  }

  /** Shows only what has the words of the filter in its name, its meaning or its unit. */
  private sift(): void {
    const words = this.filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    let found = 0;
    for (const group of this.groups.querySelectorAll<HTMLDetailsElement>("details")) {
      let inside = 0;
      for (const field of group.querySelectorAll<HTMLElement>(".field")) {
        const text = `${field.dataset.name} ${field.textContent}`.toLowerCase();
        field.hidden = !words.every((word) => text.includes(word));
        inside += Number(!field.hidden);
      }
      const twice = words.length > 0 && group.dataset.group === "often";
      group.hidden = inside === 0 || twice;
      group.open = words.length > 0 ? !group.hidden : this.open.has(group.dataset.group ?? "");
      found += twice ? 0 : inside;
    }
    byId("nothing").hidden = found > 0 || words.length === 0;
  }
}

function title(group: string): string {
  const words = group.replaceAll(/[_.]/g, " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

/** Turns about x and y [rad] that bring the vertical onto a normal. */
export function tilts(normal: number[]): [number, number] {
  const size = Math.hypot(...normal) || 1;
  const [x, y, z] = normal.map((value) => value / size);
  return [-Math.asin(Math.min(Math.max(y, -1), 1)), Math.atan2(x, z)];
}

export function tilted([a, b]: [number, number]): number[] {
  return [Math.sin(b) * Math.cos(a), -Math.sin(a), Math.cos(b) * Math.cos(a)].map((value) => Number(value.toFixed(9)));
}
