/** The page: brings together what is heard, what is shown, and what is asked for. */

import { Vector3 } from "three";
import { startActions } from "./actions";
import type { Quantity } from "./colours";
import { byId, tell } from "./dom";
import { Hand } from "./hand";
import { Legend } from "./legend";
import { Link } from "./link";
import { Panel } from "./panel";
import { Player } from "./player";
import { Plots } from "./plots";
import { Readouts } from "./readouts";
import { Stage, type Looking } from "./stage";
import { startTheme } from "./theme";
import { Condition } from "./condition";
import { decode, encode, VERSION, VIRTUAL, type Frame, type Said, type Told } from "./wire";
import { World, type Layers } from "./world";
import { WrenchLabel } from "./wrench";

const SHORTEST = 12; // ms between two poses: as often as a screen draws,
const SLOW = 25; // and where it draws less often than that, by a clock
const CLOCK = 16;
const LONGEST = 0.25; // s that the time between two poses counts for, however long it is

const say = (message: Said): void => link.say(message);
const stage = makeStage();
const world = stage === null ? null : new World(stage);
const readouts = new Readouts();
const plots = new Plots();
const legend = new Legend();
const panel = new Panel((name, value) => say({ type: "set", name, value }));
const player = new Player(say);
const actions = startActions(say);
const hand = world === null ? null : new Hand(world, say, send, () => player.toggle(), actions);
const wrench = new WrenchLabel();
const condition = new Condition(() => link.retry(), fresh);
const rate = byId<HTMLSelectElement>("frames");
let newest: Frame | null = null;
let moved = performance.now();
let drawn = 0; // the last frame that was
let told = true; // whether the server knows of it
let pictures = 0; // of the screen, in which something may have been drawn

const link = new Link({
  opened: () => {
    newest = null;
    [drawn, told] = [0, true];
  },
  told: hear,
  bytes: (buffer) => {
    const got = decode(buffer);
    if (got.kind === "frame") {
      if (newest !== null && condition.live) plots.add(newest); // skipped as a picture, but not in the plots
      newest = got;
    } else {
      world?.use(got);
      hand?.use(got);
      readouts.use(got);
      legend.limits(got);
      showLayers();
      tell("nodes", String(got.rest.length / 3));
    }
  },
  failed: (why) => actions.notice("error", `a message that cannot be used: ${why}`),
  changed: (state, retryIn) => {
    condition.link(state, retryIn);
    if (state === "waiting") hand?.lost();
  },
});

startTheme(() => {
  world?.repaint();
  hand?.repaint();
  plots.repaint();
});
startChoices();
fresh(false);
requestAnimationFrame(picture);
window.setInterval(() => move(SLOW), CLOCK);

function hear(message: Told): void {
  if (message.type === "hello") {
    if (message.version !== VERSION) {
      condition.outdated();
      return;
    }
    document.title = `${message.title} · finger_sim`;
    condition.welcome(message);
    actions.welcome(message);
    player.use(message.bag);
    readouts.recordings(message.recorded ?? []);
    plots.clear();
    hand?.welcome(message.client, message.drive && message.source === "node");
    say({ type: "frames", hz: Number(rate.value) });
  } else if (message.type === "status") {
    condition.status(message);
    actions.status(message);
    if (condition.live) {
      readouts.status(message);
      panel.status(message);
    }
  } else if (message.type === "parameters") panel.use(message.items);
  else if (message.type === "values") panel.told(message.values);
  else if (message.type === "handle") hand?.told(message.holder);
  else if (message.type === "notice") actions.notice(message.level, message.text);
  else if (message.type === "yaml") actions.yaml(message.text, message.name);
  else if (message.type === "recorded") {
    readouts.recorded(message);
    actions.notice("info", `recorded: ${message.name}`);
  } else if (message.type === "position") player.told(message.time, message.playing, message.speed);
}

/** Moves what keys, gamepad and spring move, and sends the pose of a finger that is held, unless one was just sent. */
function move(shortest: number): void {
  const now = performance.now();
  if (now - moved < shortest) return;
  hand?.tick(Math.min((now - moved) / 1e3, LONGEST));
  moved = now;
}

/** Sends a pose, and what was drawn by now. */
function send(pose: number[]): void {
  link.say(encode(drawn, pose));
  told = true;
}

/** Once for each picture of the screen: takes the newest frame, and draws. */
function picture(now: number): void {
  requestAnimationFrame(picture);
  const frame = newest;
  newest = null;
  if (frame !== null) show(frame);
  plots.tick(now);
  tell("pictures", String((pictures += 1)));
  if (world !== null && stage !== null) {
    hand?.beforeDrawing();
    world.beforeDrawing();
    if (stage.draw()) {
      wrench.place(world, condition.live);
      tellPlace(world, stage);
    }
  }
  if (frame !== null) {
    [drawn, told] = [frame.seq, false];
    tell("time", frame.time.toFixed(4));
    tell("seq", String(frame.seq));
  }
  move(SHORTEST);
  if (!told) link.say(encode(drawn, null));
  told = true;
}

function show(frame: Frame): void {
  if (!condition.frame()) return;
  plots.add(frame);
  if (world !== null && !world.show(frame)) return;
  readouts.frame(frame);
  if (world === null) return;
  hand?.show(frame);
  const { sticking, slipping, arrowForce } = world.touch;
  if (world.scale !== null) legend.scale(world.scale);
  legend.keys(world.layers, arrowForce, (frame.flags & VIRTUAL) !== 0, sticking, slipping);
  tell("sticks", String(sticking));
  tell("slips", String(slipping));
}

/** Where on the screen the finger frame's origin is, in pixels of the window. */
function tellPlace({ frame }: World, stage: Stage): void {
  const at = frame === null ? null : stage.project(new Vector3().fromArray(frame.pose));
  const { left, top } = stage.canvas.getBoundingClientRect();
  tell("finger", at === null ? "" : `${Math.round(left + at.x)},${Math.round(top + at.y)}`);
}

/** What is shown is live from now on, or is not. */
function fresh(live: boolean): void {
  world?.live(live);
  actions.live(live);
  panel.live(live);
  if (live) return;
  readouts.blank();
  legend.blank();
  plots.clear();
  hand?.stale();
  wrench.hide();
}

function makeStage(): Stage | null {
  try {
    return new Stage(byId("viewport"));
  } catch (error) {
    const note = document.createElement("p");
    note.className = "nowebgl";
    note.textContent = "This browser gives no WebGL 2, so the finger is not drawn. Numbers and parameters work.";
    byId("viewport").prepend(note);
    tell("webgl", String(error));
    return null;
  }
}

function startChoices(): void {
  for (const radio of document.querySelectorAll<HTMLInputElement>("#colour-by input")) {
    radio.addEventListener("change", () => {
      if (world === null) return;
      world.quantity = radio.value as Quantity;
      refresh();
    });
  }
  for (const box of document.querySelectorAll<HTMLInputElement>("[data-layer]")) {
    box.addEventListener("change", () => {
      if (world === null) return;
      world.layers[box.dataset.layer as keyof Layers] = box.checked;
      refresh();
    });
  }
  for (const button of document.querySelectorAll<HTMLButtonElement>("[data-look]")) {
    button.addEventListener("click", () => world?.look(button.dataset.look as Looking));
  }
  rate.addEventListener("change", () => say({ type: "frames", hz: Number(rate.value) }));
}

function refresh(): void {
  if (world === null) return;
  world.refresh();
  if (world.scale !== null && condition.live) legend.scale(world.scale);
  showLayers();
}

function showLayers(): void {
  if (world === null || !condition.live) return;
  const { sticking, slipping, arrowForce } = world.touch;
  const virtual = world.frame !== null && (world.frame.flags & VIRTUAL) !== 0;
  legend.keys(world.layers, arrowForce, virtual, sticking, slipping);
}
