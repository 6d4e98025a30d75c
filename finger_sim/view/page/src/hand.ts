/** The hand: pointer, keys and gamepad on one handle, and the bar that says who holds the finger. */

import type { Actions } from "./actions";
import { byId, memory, tell, write } from "./dom";
import { Grip, type Drag } from "./grip";
import { Handle } from "./handle";
import { Keys } from "./keys";
import { Pad } from "./pad";
import type { Frame, Said, Topology } from "./wire";
import type { World } from "./world";

const DOING = { move: "moving", press: "pressing", turn: "turning", roll: "turning", none: "holding" };

export class Hand {
  private readonly handle: Handle;
  private readonly grip: Grip;
  private readonly keys: Keys;
  private readonly pad: Pad;
  private readonly button = byId<HTMLButtonElement>("hold");
  private frame: Frame | null = null;

  constructor(
    private readonly world: World,
    say: (message: Said) => void,
    send: (pose: number[]) => void,
    pause: () => void,
    actions: Actions,
  ) {
    const { stage } = world;
    this.handle = new Handle(say, send, world.ground, () => this.show());
    const springs = byId<HTMLInputElement>("springs");
    this.grip = new Grip(stage, world, this.handle, () => !springs.checked, () => this.show());
    this.pad = new Pad(stage, world, this.handle, (name) => {
      write(byId("pad-text"), name === null ? "No gamepad. Press a button of one to use it." : `Gamepad: ${name}`);
      tell("pad", name ?? "");
    });
    this.keys = new Keys(byId("viewport"), stage, world, this.handle, {
      reset: () => actions.reset(),
      pause,
      resetView: () => world.look("reset"),
      help: () => actions.help(),
    });
    springs.checked = memory.get("springs") !== "false";
    this.handle.springs = springs.checked;
    springs.addEventListener("change", () => {
      this.handle.springs = springs.checked;
      memory.set("springs", String(springs.checked));
    });
    this.startDeepest();
    for (const radio of document.querySelectorAll<HTMLInputElement>("#drag input")) {
      radio.addEventListener("change", () => {
        this.grip.drag = radio.value as Drag;
        stage.request();
      });
    }
    this.button.addEventListener("click", () => (this.handle.held ? this.handle.let() : this.handle.take()));
    window.addEventListener("blur", () => this.handle.drop());
    window.addEventListener("pagehide", () => this.handle.drop());
    document.addEventListener("visibilitychange", () => document.hidden && this.handle.drop());
    this.show();
  }

  welcome(client: number, drive: boolean): void {
    this.handle.welcome(client, drive);
    this.show();
  }

  told(holder: number | null): void {
    this.handle.told(holder);
    this.show();
  }

  /** The connection is gone, and with it the handle. */
  lost(): void {
    this.handle.lost();
  }

  /** Where the finger is, is not known any more: nothing can be dragged. */
  stale(): void {
    this.handle.drop();
    this.frame = null;
    byId("hand-now").hidden = true;
  }

  use(topology: Topology): void {
    this.handle.use(topology);
  }

  show(frame?: Frame): void {
    if (frame !== undefined) {
      this.frame = frame;
      this.handle.show(frame);
      this.numbers();
      return;
    }
    const { hold, holder } = this.handle;
    tell("handle", hold);
    tell("drag", this.grip.doing);
    write(byId("hand-text"), this.words());
    this.button.disabled = hold === "none" || hold === "other";
    write(this.button, this.handle.held ? "Let go" : "Take");
    this.button.title = hold === "other" ? `Page ${holder} must let go first` : "";
    this.numbers();
    this.world.stage.request();
  }

  tick(dt: number): void {
    this.keys.tick(dt);
    this.pad.tick(dt);
    this.handle.tick(dt);
  }

  beforeDrawing(): void {
    this.grip.beforeDrawing();
  }

  repaint(): void {
    this.grip.repaint();
  }

  /** Depth and speed, while it is held. */
  private numbers(): void {
    const shown = (this.handle.hold === "mine" || this.handle.hold === "letting") && this.frame !== null;
    const now = byId("hand-now");
    now.hidden = !shown;
    if (!shown || this.frame === null) return;
    write(now, `${(1e3 * this.frame.depth).toFixed(2)} mm deep · ${(1e3 * this.handle.speed).toFixed(0)} mm/s`);
  }

  private words(): string {
    switch (this.handle.hold) {
      case "free":
        return "Drag the finger";
      case "asked":
        return "asking";
      case "mine":
        return `You: ${DOING[this.grip.doing]}`;
      case "letting":
        return "springs back";
      case "other":
        return `Page ${this.handle.holder} holds it`;
      case "none":
        return "View only";
    }
  }

  private startDeepest(): void {
    const field = byId<HTMLInputElement>("deepest");
    const use = (text: string): void => {
      const mm = Number(text.replace(",", "."));
      const fits = text.trim() !== "" && mm >= 0.1 && mm <= 20;
      field.setAttribute("aria-invalid", String(!fits));
      field.title = fits ? "" : "0.1 to 20 mm";
      if (!fits) return;
      this.handle.deepest = mm / 1e3;
      memory.set("deepest", String(mm));
    };
    const kept = memory.get("deepest");
    if (kept !== null) {
      field.value = kept;
      use(kept);
    }
    field.addEventListener("change", () => use(field.value));
  }
}
