/** What colours, marks and arrows mean, with numbers. */

import { RAMP, type Scale } from "./colours";
import { byId, make, MISSING, number, short, tell, write } from "./dom";
import type { Layers } from "./world";
import type { Topology } from "./wire";

export class Legend {
  private ticks = "";

  constructor() {
    const stops = RAMP.map(([r, g, b], k) => `rgb(${r} ${g} ${b}) ${((100 * k) / (RAMP.length - 1)).toFixed(1)}%`);
    byId("ramp").style.background = `linear-gradient(to top, ${stops.join(", ")})`;
  }

  scale(scale: Scale): void {
    write(byId("legend-title"), scale.unit === "" ? scale.title : `${scale.title} [${scale.unit}]`);
    const decimals = scale.most >= 100 ? 0 : scale.most >= 10 ? 1 : 2;
    const over = scale.open && scale.most >= scale.top - 1e-6;
    write(byId("legend-most"), `max ${over ? "≥ 2.0" : number(scale.most, decimals)}${scale.unit === "" ? "" : ` ${scale.unit}`}`);
    tell("most", scale.most.toFixed(3));
    byId("ramp-most").hidden = false;
    byId("ramp-most").style.bottom = `${100 * Math.min(scale.most / scale.top, 1)}%`;
    const ticks = JSON.stringify(scale.ticks);
    if (ticks === this.ticks) return;
    this.ticks = ticks;
    const marks = scale.ticks.map(({ place, text }) => {
      const mark = make("li", {}, text);
      mark.style.bottom = `${100 * place}%`;
      if (text.includes("limit")) mark.className = "limit";
      return mark;
    });
    byId("ramp-ticks").replaceChildren(...marks);
  }

  /** Nothing is known of the present. */
  blank(): void {
    write(byId("legend-most"), `max ${MISSING}`);
    byId("ramp-most").hidden = true;
    byId("keys").hidden = true;
    tell("most", "");
  }

  /** The keys of what is shown. arrow: what the longest stands for [N]. */
  keys(layers: Layers, arrow: number, virtual: boolean, sticking: number, slipping: number): void {
    byId("keys").hidden = false;
    byId("key-contacts").hidden = !layers.contacts;
    byId("key-forces").hidden = !layers.forces;
    byId("key-wrench").hidden = !layers.forces;
    byId("key-axes").hidden = !layers.axes;
    byId("key-bone").hidden = !layers.bone;
    byId("key-nail").hidden = !layers.nail;
    byId("key-ghost").hidden = !layers.ghost && !virtual;
    byId("key-grid").hidden = !layers.plane;
    write(byId("key-sticks"), `${sticking} stick`);
    write(byId("key-slips"), `${slipping} slip`);
    write(byId("key-arrow"), `force of a node, ${short(arrow)} N`);
  }

  /** How far each axis may be stretched and compressed. */
  limits({ limits }: Topology): void {
    for (let k = 0; k < 3; k++) {
      const [stretch, compress] = limits === null ? [NaN, NaN] : [limits[2 * k], limits[2 * k + 1]];
      const known = [compress, stretch].map((value) => (Number.isFinite(value) ? short(Number(value.toPrecision(4))) : "free"));
      write(byId(`key-e${k + 1}`), limits === null ? `e${k + 1}` : `e${k + 1}: ${known[0]} to ${known[1]}`);
    }
  }
}
