/** A recording: where in it we are, whether it goes on, and how fast. */

import { byId, number, sparsely, tell, write } from "./dom";
import type { Said } from "./wire";

const SENT = 40; // ms between two places that are sought while the slider moves
const STEPS = 2000;

export class Player {
  private readonly slider = byId<HTMLInputElement>("time");
  private readonly button = byId<HTMLButtonElement>("play");
  private readonly speeds = byId<HTMLSelectElement>("speed");
  private duration = 0;
  private playing = false;
  private sought = -Infinity;
  private readonly seek = sparsely(SENT, (time: number) => this.say({ type: "seek", time }));

  constructor(private readonly say: (message: Said) => void) {
    this.slider.max = String(STEPS);
    this.slider.addEventListener("input", () => {
      const time = (Number(this.slider.value) / STEPS) * this.duration;
      this.sought = performance.now();
      this.tell(time);
      this.seek(time);
    });
    this.button.addEventListener("click", () => this.toggle());
    this.speeds.addEventListener("change", () => this.play(this.playing));
  }

  /** Shows the bar for a recording so long [s]; null: there is none. */
  use(bag: { name: string; duration: number } | undefined): void {
    byId("player").hidden = bag === undefined;
    this.duration = bag?.duration ?? 0;
    write(byId("bag-name"), bag?.name ?? "");
    write(byId("bag-end"), `${number(this.duration, 1)} s`);
    tell("playing", bag === undefined ? "" : "false");
  }

  told(time: number, playing: boolean, speed: number): void {
    this.playing = playing;
    this.button.setAttribute("aria-label", playing ? "Pause" : "Play");
    this.button.title = `${playing ? "Pause" : "Play"} (Space)`;
    this.button.dataset.playing = String(playing);
    tell("playing", String(playing));
    if (![...this.speeds.options].some((option) => Number(option.value) === speed)) {
      this.speeds.add(new Option(`${speed}×`, String(speed)));
    }
    this.speeds.value = String(speed);
    if (performance.now() - this.sought < 300) return; // the hand on the slider is ahead of the server
    this.slider.value = String(this.duration > 0 ? Math.round((time / this.duration) * STEPS) : 0);
    this.tell(time);
  }

  toggle(): void {
    if (!byId("player").hidden) this.play(!this.playing);
  }

  private play(on: boolean): void {
    this.say({ type: "play", on, speed: Number(this.speeds.value) });
  }

  private tell(time: number): void {
    write(byId("bag-time"), `${number(time, 2)} s`);
    this.slider.setAttribute("aria-valuetext", `${number(time, 2)} of ${number(this.duration, 1)} seconds`);
    tell("position", time.toFixed(3));
  }
}
