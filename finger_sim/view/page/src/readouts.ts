/** Numbers and words of the present state. What is not live is shown as a dash, never as a number. */

import { Quaternion, Vector3 } from "three";
import { byId, make, measure, MISSING, number, tell, write } from "./dom";
import { DEVICE_KNOWN, PLANE_KNOWN, type Frame, type Recorded, type Status, type Topology } from "./wire";

const ids = ["rate", "factor", "late", "step", "limits", "contacts", "command", "area"] as const;
const SIGN = { info: "i", warn: "!", error: "×" };

export class Readouts {
  private readonly stats = Object.fromEntries(ids.map((id) => [id, byId(`stat-${id}`)])) as Record<(typeof ids)[number], HTMLElement>;
  private readonly words = byId("words");
  private readonly friction = byId<HTMLMeterElement>("friction-used");
  private said = "";
  private tets: number | null = null; // of the mesh
  private offered: Recorded[] = [];

  use(topology: Topology): void {
    this.tets = topology.tets.length > 0 ? topology.tets.length / 4 : null;
  }

  /** Of each frame. */
  frame(frame: Frame): void {
    const normal = new Vector3(0, 0, 1);
    if ((frame.flags & PLANE_KNOWN) !== 0) normal.applyQuaternion(new Quaternion().fromArray(frame.plane, 3));
    const slipping = frame.contacts.filter(({ slips }) => slips).length;
    const sticking = frame.contacts.length - slipping;
    const force = new Vector3().fromArray(frame.force);
    const along = force.dot(normal);
    const across = force.projectOnPlane(normal).length();
    const device = (frame.flags & DEVICE_KNOWN) !== 0 ? Math.hypot(...frame.deviceForce) : null;
    write(byId("value-normal"), number(along, 2));
    write(byId("value-tangential"), number(across, 2));
    write(byId("value-device"), number(device, 2));
    write(byId("value-depth"), number(1e3 * frame.depth, 2));
    const used = along > 0.01 && frame.friction > 0 ? across / (frame.friction * along) : 0;
    this.friction.value = Math.min(used, 1);
    const slip = slipping === 0 ? "" : `, ${slipping} slip`;
    write(byId("friction-text"), `${Math.round(100 * used)} % of μ ${number(frame.friction, 2)}`);
    write(this.stats.contacts, sticking + slipping === 0 ? "none" : `${sticking} stick${slip}`);
    tell("force", along.toFixed(4));
    tell("tangential", across.toFixed(4));
    tell("depth", (1e3 * frame.depth).toFixed(4));
  }

  status(status: Status): void {
    const { stats } = this;
    const { p50, p99 } = status.step_ms ?? { p50: null, p99: null };
    write(stats.rate, measure(status.rate, 0, "Hz"));
    write(stats.factor, number(status.real_time_factor, 3));
    write(stats.late, status.late === null ? MISSING : `${status.late} (${number(status.late_percent, 2)} %)`);
    write(stats.step, p50 === null ? MISSING : `${number(p50, 2)} / ${number(p99, 2)} ms`);
    const locked = (status.locked ?? 0) > 0 ? `, ${status.locked} locked` : "";
    write(stats.limits, status.limited === null ? MISSING : `${status.limited} of ${status.tets ?? this.tets ?? MISSING}${locked}`);
    write(stats.area, measure(status.contact_area === null ? null : 1e6 * status.contact_area, 1, "mm²"));
    const { age, rate, mode } = status.command ?? { age: null, rate: null, mode: null };
    const nobody = status.command === null || (age === null && status.rate === null);
    if (nobody) write(stats.command, MISSING);
    const old = age === null ? "none yet" : `${number(age, age < 10 ? 1 : 0)} s ago`;
    const fresh = age !== null && age < 1 && rate !== null ? `${number(rate, 0)} Hz` : old;
    if (!nobody) write(stats.command, mode === null ? fresh : `${fresh}, ${mode}`);
    this.say(status);
    tell("rate", number(status.rate, 1));
    tell("limited", String(status.limited ?? ""));
  }

  /** Nothing that is shown would be so: dashes. */
  blank(): void {
    for (const element of Object.values(this.stats)) write(element, MISSING);
    for (const name of ["normal", "tangential", "device", "depth"]) write(byId(`value-${name}`), MISSING);
    this.friction.value = 0;
    write(byId("friction-text"), MISSING);
    this.words.replaceChildren(make("li", { className: "quiet" }, MISSING));
    this.said = "";
    for (const name of ["force", "tangential", "depth", "rate", "limited"]) tell(name, "");
  }

  /** Another recording that can be fetched. */
  recorded(recording: Recorded): void {
    this.recordings([...this.offered, recording]);
  }

  /** All recordings that can be fetched; the newest are offered. */
  recordings(all: Recorded[]): void {
    this.offered = all.filter(({ url }) => new URL(url, location.href).origin === location.origin).slice(-5);
    const entries = this.offered.map(({ name, url, bytes }) => {
      const size = bytes === null ? "" : ` (${(bytes / 1e6).toFixed(1)} MB)`;
      return make("li", {}, make("a", { href: url, download: name }, `${name}${size}`));
    });
    byId("recordings").replaceChildren(...entries.reverse());
    byId("recordings-card").hidden = entries.length === 0;
  }

  private say({ words, rate }: Status): void {
    const said = JSON.stringify([words, rate === null]);
    if (said === this.said) return;
    this.said = said;
    const lines = words.map(({ code, text, level }) =>
      make("li", { className: level }, make("span", { className: "sign", attributes: { "aria-hidden": "true" } }, SIGN[level]), ` ${text}`, ...(code === "" ? [] : [make("code", {}, code)])),
    );
    const well = make("li", { className: "well" }, make("span", { className: "sign", attributes: { "aria-hidden": "true" } }, "✓"), " all well");
    const none = rate === null ? make("li", { className: "quiet" }, MISSING) : well; // nobody has said that all is well
    this.words.replaceChildren(...(lines.length > 0 ? lines : [none]));
  }
}
