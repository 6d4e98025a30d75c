/** The buttons of the head: scene, record, reset, YAML, help, panel; and notices that come and go. */

import { byId, make, tell, write } from "./dom";
import type { Hello, Level, Said, Status } from "./wire";

const SHOWN = 7000; // ms of a notice; an error stays until it is closed
const MOST = 4;
const SIGN: Record<Level, string> = { info: "i", warn: "!", error: "×" };

export interface Actions {
  welcome(hello: Hello): void;
  live(on: boolean): void;
  status(status: Status): void;
  notice(level: Level, text: string): void;
  yaml(text: string, name: string): void;
  reset(): void;
  help(): void;
}

export function startActions(say: (message: Said) => void): Actions {
  const scene = byId<HTMLSelectElement>("scene");
  const record = byId<HTMLButtonElement>("record");
  const yamlDialog = byId<HTMLDialogElement>("yaml-dialog");
  const notices = byId("notices");
  let recording = false;
  let drives = false;
  let live = false;
  const enable = (): void => {
    scene.disabled = !live || !drives || scene.options.length < 2;
    record.disabled = byId<HTMLButtonElement>("reset").disabled = !live || !drives;
    byId<HTMLButtonElement>("yaml").disabled = !live;
  };

  const notice = (level: Level, text: string): void => {
    const close = make("button", { type: "button" }, "Close");
    const entry = make("li", { className: level }, make("b", { attributes: { "aria-hidden": "true" } }, SIGN[level]), make("span", {}, text), close);
    close.addEventListener("click", () => entry.remove());
    if (notices.lastElementChild?.querySelector("span")?.textContent === text) notices.lastElementChild.remove();
    notices.append(entry);
    while (notices.childElementCount > MOST) notices.firstElementChild?.remove();
    if (level !== "error") window.setTimeout(() => entry.remove(), SHOWN);
  };
  const reset = (): void => {
    if (drives && live) say({ type: "reset" });
  };
  const help = (): void => byId<HTMLDialogElement>("help-dialog").showModal();
  const copy = async (): Promise<void> => {
    const text = byId<HTMLTextAreaElement>("yaml-text");
    try {
      await navigator.clipboard.writeText(text.value);
      write(byId("yaml-state"), "Copied.");
    } catch {
      text.select(); // a browser that gives no clipboard still copies what is selected
      write(byId("yaml-state"), "Selected: copy it with your keys.");
    }
  };

  scene.addEventListener("change", () => say({ type: "scene", name: scene.value }));
  record.addEventListener("click", () => say({ type: "record", on: !recording }));
  byId("reset").addEventListener("click", reset);
  byId("yaml").addEventListener("click", () => say({ type: "yaml" }));
  byId("yaml-copy").addEventListener("click", () => void copy());
  byId("help").addEventListener("click", help);
  byId("fold").addEventListener("click", () => {
    const folded = document.body.classList.toggle("folded");
    byId("fold").setAttribute("aria-expanded", String(!folded));
  });
  for (const details of document.querySelectorAll<HTMLDetailsElement>("#layers, #hand-options")) {
    document.addEventListener("pointerdown", (event) => {
      if (details.open && !details.contains(event.target as Node)) details.open = false;
    });
    details.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || !details.open) return;
      details.open = false;
      details.querySelector("summary")?.focus();
      event.stopPropagation();
    });
  }

  return {
    notice,
    reset,
    help,
    welcome: (hello) => {
      drives = hello.drive;
      const names = hello.scenes.includes(hello.scene) ? hello.scenes : [hello.scene, ...hello.scenes];
      scene.replaceChildren(...names.map((name) => make("option", { value: name }, name)));
      scene.value = hello.scene;
      const nameless = names.every((name) => name === "");
      scene.hidden = byId("scene-label").hidden = nameless;
      enable();
    },
    live: (on) => {
      live = on;
      enable();
    },
    status: ({ recording: now }) => {
      recording = now?.on ?? false;
      record.setAttribute("aria-pressed", String(recording));
      const count = now?.messages ?? null;
      const dropped = (now?.dropped ?? 0) > 0 ? `, ${now?.dropped} dropped` : "";
      write(byId("record-text"), recording ? `Stop${count === null ? "" : ` (${count}${dropped})`}` : "Record");
      record.title = recording ? `Recording ${now?.name ?? ""}` : "Record a bag";
      tell("recording", recording ? (now?.name ?? "on") : "");
    },
    yaml: (text, name) => {
      byId<HTMLTextAreaElement>("yaml-text").value = text;
      write(byId("yaml-title"), `Scene YAML: ${name}`);
      write(byId("yaml-state"), "");
      if (!yamlDialog.open) yamlDialog.showModal();
      void copy();
    },
  };
}
