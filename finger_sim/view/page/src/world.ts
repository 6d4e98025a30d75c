/** Everything that is drawn in space, put together: shows a frame, as the chosen layers want it. */

import { Group, Quaternion, Vector3 } from "three";
import { Painter, type Quantity, type Scale } from "./colours";
import { Ghost } from "./ghost";
import { Ground } from "./ground";
import { LimitAxes, Wireframe } from "./inside";
import { Skin } from "./skin";
import type { Looking, Stage } from "./stage";
import { Touch } from "./touch";
import type { Frame, Topology } from "./wire";

export interface Layers {
  wireframe: boolean;
  bone: boolean;
  nail: boolean;
  axes: boolean;
  plane: boolean;
  contacts: boolean;
  forces: boolean;
  ghost: boolean;
}

export const FIRST_LAYERS: Layers = {
  wireframe: false,
  bone: false,
  nail: true,
  axes: false,
  plane: true,
  contacts: true,
  forces: true,
  ghost: false,
};

/** Between two bytes of strain: whole faces that are held right at their limit are not a line. */
const JUST_BEYOND = 128.5 / 255;

/** Whether a pose or a point is known at all. */
function known(values: Float32Array): boolean {
  return values.every(Number.isFinite);
}

/** Whether two frames look the same: a finger at rest is not drawn again. */
function looksLike(one: Frame, other: Frame): boolean {
  const same = (a: ArrayLike<number>, b: ArrayLike<number>): boolean => {
    for (let k = 0; k < a.length; k++) if (a[k] !== b[k] && !(Number.isNaN(a[k]) && Number.isNaN(b[k]))) return false;
    return a.length === b.length;
  };
  const arrays = ["positions", "strain", "pose", "command", "plane", "force", "torque", "centre"] as const;
  if (one.flags !== other.flags || !arrays.every((name) => same(one[name], other[name]))) return false;
  const touching = ({ node, force, slips }: Frame["contacts"][number]): number[] => [node, ...force, Number(slips)];
  return same(one.contacts.flatMap(touching), other.contacts.flatMap(touching));
}

/** What is drawn of one topology. */
interface Body {
  topology: Topology;
  group: Group;
  skin: Skin;
  wireframe: Wireframe;
  axes: LimitAxes;
  ghost: Ghost;
  painter: Painter;
}

export class World {
  readonly ground = new Ground();
  readonly touch = new Touch(this.ground);
  readonly layers: Layers = { ...FIRST_LAYERS };
  quantity: Quantity = "strain";
  frame: Frame | null = null;
  scale: Scale | null = null;
  body: Body | null = null;

  constructor(readonly stage: Stage) {
    stage.scene.add(this.ground.mesh, this.touch.group, this.touch.forces);
  }

  /** Shows another body from now on. */
  use(topology: Topology): void {
    const first = this.body === null;
    if (this.body !== null) {
      this.stage.scene.remove(this.body.group);
      this.body.skin.dispose();
    }
    const skin = new Skin(topology);
    const [wireframe, axes, ghost] = [new Wireframe(topology, skin.nodes), new LimitAxes(topology), new Ghost(topology)];
    const group = new Group();
    group.add(skin.shadow, skin.mesh, wireframe.lines, axes.group, ghost.group);
    this.body = { topology, group, skin, wireframe, axes, ghost, painter: new Painter(topology) };
    this.frame = null;
    this.repaint();
    if (first) this.look("reset");
  }

  /** Shows a frame of the present topology; false: it is of another. */
  show(frame: Frame): boolean {
    const body = this.body;
    if (body === null || frame.generation !== body.topology.generation) return false;
    if (frame.positions.length !== body.topology.rest.length) return false;
    const before = this.frame;
    const first = before === null;
    this.frame = frame;
    if (first) this.stage.scene.add(body.group);
    if (before === null || !looksLike(before, frame)) this.refresh();
    if (first) this.look("reset");
    return true;
  }

  /** Draws the last frame again, after a layer or a quantity has changed. */
  refresh(): void {
    const { body, frame, layers } = this;
    this.stage.request();
    if (body === null || frame === null) return;
    this.ground.update(frame);
    this.ground.mesh.visible &&= layers.plane;
    body.painter.quantity = this.quantity;
    this.scale = body.painter.paint(frame);
    const through = layers.wireframe || layers.axes;
    body.skin.appear(through, layers.wireframe);
    body.skin.update(frame.positions, body.painter.values);
    const { uniforms } = body.skin.mesh.material;
    uniforms.contour.value = this.quantity === "strain" ? JUST_BEYOND : 0;
    uniforms.showBone.value = Number(layers.bone);
    uniforms.showNail.value = Number(layers.nail);
    body.wireframe.lines.visible = layers.wireframe;
    body.axes.group.visible = layers.axes;
    body.axes.update(frame.positions);
    body.ghost.update(frame, layers.ghost);
    this.touch.update(frame);
    this.touch.group.visible = layers.contacts;
    this.touch.forces.visible = layers.forces;
    body.skin.shadow.material.uniforms.origin.value = this.ground.origin;
    body.skin.shadow.material.uniforms.up.value = this.ground.normal;
  }

  /** A shadow is on the side of the plane that the finger is on. */
  beforeDrawing(): void {
    if (this.body === null) return;
    this.touch.face(this.stage.camera);
    const above = this.ground.height(this.stage.camera.position) > 0;
    this.body.skin.shadow.visible = this.ground.mesh.visible && above;
  }

  /** What is shown is live; or no longer so: then it is grey, without forces. */
  live(on: boolean): void {
    this.touch.group.visible = on && this.layers.contacts;
    this.touch.forces.visible = on && this.layers.forces;
    if (this.body !== null) this.body.skin.mesh.material.uniforms.dim.value = on ? 0 : 0.85;
    this.stage.request();
  }

  look(from: Looking): void {
    const at = new Vector3(-0.008, 0, 0);
    if (this.frame !== null && known(this.frame.pose)) {
      at.applyQuaternion(new Quaternion().fromArray(this.frame.pose, 3)).add(new Vector3().fromArray(this.frame.pose));
      if (this.ground.known) at.addScaledVector(this.ground.normal, 0.002 - 0.55 * this.ground.height(at));
    }
    this.stage.look(from, at, this.ground.orientation);
  }

  repaint(): void {
    this.stage.repaint();
    for (const part of [this.ground, this.touch, this.body?.skin, this.body?.wireframe, this.body?.axes, this.body?.ghost]) {
      part?.repaint();
    }
  }
}
