/** Small helpers for elements; styles go through the CSSOM, as the page's policy allows no inline ones. */

/** The element of that id, which index.html has. */
export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (found === null) throw new Error(`index.html has no element #${id}`);
  return found as T;
}

/** A new element with properties, and children in it. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Partial<Omit<HTMLElementTagNameMap[K], "style" | "attributes">> & { attributes?: Record<string, string> } = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const { attributes, ...rest } = properties;
  const made = Object.assign(document.createElement(tag), rest);
  for (const [name, value] of Object.entries(attributes ?? {})) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/** Text is written only where it changes: a write costs a layout. */
export function write(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** What tests, and people who look into the page, can read of it: data attributes of <html>. */
export function tell(name: string, value: string): void {
  const hooks = document.documentElement.dataset;
  if (hooks[name] !== value) hooks[name] = value;
}

export const MISSING = "–";

/** A number with so many decimals; a dash where it is not known. */
export function number(value: number | null | undefined, decimals: number): string {
  return value === null || value === undefined || !Number.isFinite(value) ? MISSING : value.toFixed(decimals);
}

/** The same with a unit, which a dash has not. */
export function measure(value: number | null | undefined, decimals: number, unit: string): string {
  const text = number(value, decimals);
  return text === MISSING ? text : `${text} ${unit}`;
}

/** A number with three significant digits, as people write it. */
export function short(value: number): string {
  if (!Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) {
    return value.toExponential(2).replace(/\.?0+e/, "e").replace("e+", "e");
  }
  return String(Number(value.toPrecision(6)));
}

/** Calls at most once in so many milliseconds, the last time with the last arguments. */
export function sparsely<A extends unknown[]>(interval: number, call: (...given: A) => void): (...given: A) => void {
  let last = -Infinity;
  let timer: number | undefined;
  return (...given) => {
    window.clearTimeout(timer);
    const wait = last + interval - performance.now();
    const now = (): void => {
      last = performance.now();
      call(...given);
    };
    if (wait <= 0) now();
    else timer = window.setTimeout(now, wait);
  };
}

/** What a browser remembers for the page; nothing where it may not. */
export const memory = {
  get(name: string): string | null {
    try {
      return localStorage.getItem(`finger_sim.${name}`);
    } catch {
      return null;
    }
  },
  set(name: string, value: string): void {
    try {
      localStorage.setItem(`finger_sim.${name}`, value);
    } catch {
      // A browser that keeps nothing is no reason to stop.
    }
  },
};
