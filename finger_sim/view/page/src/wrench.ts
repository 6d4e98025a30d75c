/** The number at the arrow of the whole contact force. */

import { Vector3 } from "three";
import { byId, write } from "./dom";
import type { World } from "./world";

const LEAST_TORQUE = 5e-5; // N m

export class WrenchLabel {
  private readonly label = byId("wrench");
  private readonly views = byId("overlay-views");

  /** Puts it where the arrow ends; called after a picture was drawn. */
  place(world: World, live: boolean): void {
    const { frame, touch, layers, stage } = world;
    const at = touch.label === null ? null : stage.project(touch.label);
    const shown = live && layers.forces && frame !== null && at !== null;
    this.label.hidden = !shown;
    if (!shown || frame === null || at === null) return;
    const force = new Vector3().fromArray(frame.force).length();
    const torque = touch.spin(frame);
    const turning = Math.abs(torque) < LEAST_TORQUE ? "" : ` · ${(1e3 * torque).toFixed(1).replace("-", "−")} mN m`;
    write(this.label, `${force.toFixed(2)} N${turning}`);
    const x = Math.min(Math.max(at.x + 10, 4), stage.size.x - 130);
    const least = this.views.offsetTop + this.views.offsetHeight + 4; // below the buttons
    const y = Math.min(Math.max(at.y - 26, least), stage.size.y - 30);
    this.label.style.transform = `translate(${Math.round(x)}px, ${Math.round(y)}px)`;
  }

  hide(): void {
    this.label.hidden = true;
  }
}
