/** In which condition node and connection are, said in words; and whether what is shown is live. */

import { byId, tell, write } from "./dom";
import type { LinkState } from "./link";
import type { Hello, Status } from "./wire";

type Kind = "connecting" | "starting" | "live" | "bag" | "gone" | "stalled" | "silent" | "waiting" | "outdated";

const STALLED = 2500; // ms without a frame of a node that runs

export class Condition {
  private kind: Kind = "connecting";
  private state: LinkState = "connecting";
  private retryIn = 0;
  private hello: Hello | null = null;
  private phase: Status["phase"] | null = null;
  private message = "";
  private framed = 0;
  private old = false;
  private lost = "";

  constructor(
    retry: () => void,
    private readonly fresh: (live: boolean) => void,
  ) {
    byId("retry").addEventListener("click", () => (this.old ? location.reload() : retry()));
    window.setInterval(() => this.decide(), 250);
    document.addEventListener("visibilitychange", () => (this.framed = performance.now()));
    this.show();
  }

  /** Whether numbers that come now are shown. */
  get live(): boolean {
    return this.kind === "live" || this.kind === "bag" || this.kind === "stalled";
  }

  link(state: LinkState, retryIn: number): void {
    if (this.state === "open" && state !== "open") this.lost = new Date().toLocaleTimeString();
    if (state === "waiting" || state === "connecting") [this.hello, this.phase] = [null, null];
    [this.state, this.retryIn] = [state, retryIn];
    this.decide();
  }

  welcome(hello: Hello): void {
    [this.hello, this.phase, this.framed] = [hello, null, performance.now()];
    this.decide();
  }

  status({ phase, message }: Status): void {
    [this.phase, this.message] = [phase, message];
    this.decide();
  }

  /** A frame came; whether it is to be shown. */
  frame(): boolean {
    this.framed = performance.now();
    if (this.kind === "stalled") this.decide();
    return this.live;
  }

  /** The server speaks another version: only a fresh page understands it. */
  outdated(): void {
    this.old = true;
    this.decide();
  }

  private decide(): void {
    const kind = this.find();
    const was = this.live;
    const changed = kind !== this.kind;
    this.kind = kind;
    if (changed && this.live !== was) this.fresh(this.live);
    this.show();
  }

  private find(): Kind {
    if (this.old) return "outdated";
    if (this.state === "waiting") return "waiting";
    if (this.state === "silent") return "silent";
    if (this.state === "connecting") return this.lost === "" ? "connecting" : "waiting";
    if (this.hello === null || this.phase === null) return "connecting";
    if (this.phase !== "running") return this.phase;
    if (this.hello.source === "bag") return "bag";
    return document.hidden || performance.now() - this.framed < STALLED ? "live" : "stalled";
  }

  private show(): void {
    const [text, title, more] = this.words();
    write(byId("condition-text"), text);
    tell("condition", this.kind);
    tell("stale", String(!this.live));
    byId("veil").hidden = this.kind === "live" || this.kind === "bag";
    write(byId("veil-title"), title);
    write(byId("veil-text"), more);
    byId("retry").hidden = this.kind !== "waiting" && this.kind !== "outdated";
    write(byId("retry"), this.kind === "outdated" ? "Load the page again" : "Try now");
  }

  private words(): [string, string, string] {
    const seconds = Math.max(Math.ceil(this.retryIn / 1e3), 1);
    const then = this.lost === "" ? "" : ` The finger is shown as it was at ${this.lost}.`;
    const when = this.retryIn > 0 ? `trying again in ${seconds} s` : "trying again";
    switch (this.kind) {
      case "live":
        return ["live", "", ""];
      case "bag":
        return ["recording", "", ""];
      case "connecting":
        return ["connecting", "Connecting", "The server has not answered yet."];
      case "starting":
        return ["starting", "The node is starting", this.message || "The first start compiles its kernels, for up to a minute."];
      case "gone":
        return ["node gone", "The node is gone", this.message || "The page goes on by itself as soon as it is back."];
      case "stalled":
        return ["no picture", "No picture comes", "The server answers, but has sent no frame for a while."];
      case "silent":
        return ["silent", "The server is silent", `Nothing has come for three seconds.${then}`];
      case "outdated":
        return ["outdated", "The server is newer than this page", "Load the page again to go on."];
      case "waiting":
        return [`reconnecting, ${when}`, "The connection is lost", `The page is ${when}.${then}`];
    }
  }
}
