/** The connection to the server: it comes back by itself, and says in which state it is. */

import type { Said, Told } from "./wire";

/** connecting: for the first time; open: heard lately; silent: open, but nothing came; waiting: for the next try. */
export type LinkState = "connecting" | "open" | "silent" | "waiting";

const FIRST_WAIT = 500; // ms before the second try
const LONGEST_WAIT = 5000;
const SILENT = 3000; // ms without a message, of which two a second are due
const LOST = 6000; // ms without one after which the connection is made anew

interface Ears {
  opened(): void;
  told(message: Told): void;
  bytes(buffer: ArrayBuffer): void;
  failed(why: string): void;
  changed(state: LinkState, retryIn: number): void;
}

export class Link {
  state: LinkState = "connecting";
  private socket: WebSocket | null = null;
  private wait = FIRST_WAIT;
  private retryAt = 0;
  private heard = 0;

  constructor(private readonly ears: Ears) {
    window.setInterval(() => this.watch(), 250);
    window.addEventListener("online", () => this.retry());
    document.addEventListener("visibilitychange", () => {
      // A hidden page's timers rest: what it missed is no sign of a lost server.
      this.heard = performance.now();
      if (!document.hidden) this.retry();
    });
    this.connect();
  }

  /** Sends, where there is somebody to hear it. */
  say(message: Said | ArrayBuffer): void {
    if (this.socket?.readyState !== WebSocket.OPEN) return;
    this.socket.send(message instanceof ArrayBuffer ? message : JSON.stringify(message));
  }

  /** Tries at once, where the next try is waited for. */
  retry(): void {
    if (this.state === "waiting") this.connect();
  }

  private connect(): void {
    const address = new URL("ws", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.search = location.search;
    address.hash = "";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.heard = performance.now();
    this.retryAt = 0;
    if (this.state === "waiting") this.become("connecting");
    socket.onopen = () => {
      this.heard = performance.now();
      this.ears.opened();
    };
    socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
      if (socket !== this.socket) return;
      this.heard = performance.now();
      this.wait = FIRST_WAIT;
      if (this.state !== "open") this.become("open");
      try {
        if (typeof data === "string") this.ears.told(JSON.parse(data) as Told);
        else this.ears.bytes(data);
      } catch (error) {
        this.ears.failed(String(error)); // one bad message does not end the page
      }
    };
    socket.onclose = () => {
      if (socket === this.socket) this.lost();
    };
  }

  private lost(): void {
    const socket = this.socket;
    this.socket = null;
    socket?.close();
    const wait = this.wait * (0.8 + 0.4 * Math.random());
    this.wait = Math.min(2 * this.wait, LONGEST_WAIT);
    this.retryAt = performance.now() + wait;
    this.become("waiting");
  }

  private watch(): void {
    const now = performance.now();
    if (this.state === "waiting") {
      if (now >= this.retryAt) this.connect();
      else this.ears.changed(this.state, this.retryAt - now);
    } else if (!document.hidden && now - this.heard > LOST) {
      this.lost();
    } else if (!document.hidden && this.state === "open" && now - this.heard > SILENT) {
      this.become("silent");
    }
  }

  private become(state: LinkState): void {
    this.state = state;
    this.ears.changed(state, Math.max(this.retryAt - performance.now(), 0));
  }
}
