/** Dark and light: as the system has it, or as is chosen; and the page's colours for what is drawn by code. */

import { Color } from "three";
import { byId, memory, tell } from "./dom";

export type Theme = "auto" | "dark" | "light";

const NEXT: Record<Theme, Theme> = { auto: "dark", dark: "light", light: "auto" };
const TEXT: Record<Theme, string> = { auto: "Theme: as the system", dark: "Theme: dark", light: "Theme: light" };

/** Tells `changed` each time the page's colours are others. */
export function startTheme(changed: () => void): void {
  const button = byId<HTMLButtonElement>("theme");
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const kept = memory.get("theme");
  let theme: Theme = kept === "dark" || kept === "light" ? kept : "auto";
  const apply = (): void => {
    const root = document.documentElement;
    if (theme === "auto") delete root.dataset.theme;
    else root.dataset.theme = theme;
    button.setAttribute("aria-label", TEXT[theme]);
    button.title = TEXT[theme];
    tell("dark", String(isDark()));
    changed();
  };
  button.addEventListener("click", () => {
    theme = NEXT[theme];
    memory.set("theme", theme);
    apply();
  });
  system.addEventListener("change", apply);
  apply();
}

/** Whether the page is dark right now. */
export function isDark(): boolean {
  const chosen = document.documentElement.dataset.theme;
  return chosen === "dark" || (chosen !== "light" && window.matchMedia("(prefers-color-scheme: dark)").matches);
}

const probe = document.createElement("span");

/** What a variable of page.css is right now, as rgb(…). */
export function cssColour(name: string): string {
  if (!probe.isConnected) {
    probe.hidden = true;
    document.body.append(probe);
  }
  probe.style.color = `var(--${name})`;
  return getComputedStyle(probe).color;
}

/** The same for three.js, in the page's own colours: nothing is converted on its way to the screen. */
export function colour(name: string): Color {
  return new Color(cssColour(name));
}
