/** Controls for one parameter each: a slider with a number field, a choice, a switch, or a vector. */

import { make, number, short, write } from "./dom";
import type { Item, Value } from "./wire";

const STEPS = 400; // of a slider
const WIDE = 25; // a range so many times a value makes no useful slider: a narrower one is shown
const DECADES = 3; // to each side of a value, of a logarithmic slider

/** The control of a parameter. set: what the person wants; show: what holds. */
export interface Control {
  element: HTMLElement;
  show(value: Value): void;
}

type Send = (value: Value) => void;

let made = 0;

/** A control for an item; `send` is called with each new value that somebody chooses. */
export function control(item: Item, send: Send, name = label(item.name)): Control {
  const id = `field-${++made}`;
  const doc = make("p", { className: "doc", id: `${id}-doc` }, described(item));
  const head = make("div", { className: "head" }, make("label", { htmlFor: id, className: "name", title: item.name }, name));
  if (item.unit !== "") head.append(make("span", { className: "unit" }, item.unit));
  const inner = item.live ? input(item, id, send) : fixed(id);
  const element = make("div", { className: "field", attributes: { "data-name": item.name } }, head, inner.element, doc);
  return {
    element,
    show: (value) => {
      element.dataset.value = JSON.stringify(value);
      inner.show(value);
    },
  };
}

function input(item: Item, id: string, send: Send): Control {
  if (item.kind === "choice") return choice(item, id, send);
  if (item.kind === "bool") return tick(id, send);
  if (item.kind === "vector") return vector(item, id, send);
  if (item.kind === "text") return text(id, send);
  return item.optional === true || item.value === null ? optional(item, id, send) : slider(item, id, send);
}

/** The last parts of a dotted name, as words. */
function label(name: string): string {
  const words = (name.split(".").pop() ?? name).replace(/_ms$/, "").replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

function described({ doc, low, high, unit, choices, kind, name }: Item): string {
  const bounded = kind === "number" && (low !== null || high !== null);
  const range = bounded ? ` ${low === null ? "…" : short(low)} to ${high === null ? "…" : short(high)} ${unit}`.trimEnd() + "." : "";
  const among = kind === "choice" && choices.length === 0 ? " No choice." : "";
  return `${doc.charAt(0).toUpperCase()}${doc.slice(1)}.${range}${among} (${name})`;
}

/** Where a slider's ends are, and how its place and the value belong together. */
class Range {
  private readonly low: number;
  private readonly high: number;
  private readonly log: boolean;

  constructor({ low, high, log, value }: Item) {
    const now = typeof value === "number" && Number.isFinite(value) ? value : 0;
    const [least, most] = [low ?? -Infinity, high ?? Infinity];
    this.log = log && (least > 0 || now > 0);
    if (this.log) {
      const middle = now > 0 ? now : Math.max(least, 1e-3);
      this.low = Math.max(least, middle * 10 ** -DECADES, 1e-12);
      this.high = Math.min(most, middle * 10 ** DECADES);
    } else {
      const size = Math.max(Math.abs(now), 1e-9);
      const wide = !(most - least <= WIDE * size) && !(now === 0 && most - least <= 100);
      const reach = now === 0 ? 1 : 4 * size;
      this.low = wide ? Math.max(least, least < 0 ? -reach : 0) : least;
      this.high = wide ? Math.min(most, reach) : most;
    }
  }

  place(value: number): number {
    const [v, low, high] = this.log ? [value, this.low, this.high].map((x) => Math.log(Math.max(x, 1e-30))) : [value, this.low, this.high];
    return Math.round(STEPS * Math.min(Math.max((v - low) / (high - low), 0), 1));
  }

  value(place: number): number {
    const part = place / STEPS;
    if (this.log) return Number((this.low * (this.high / this.low) ** part).toPrecision(3));
    const step = 10 ** Math.floor(Math.log10((this.high - this.low) / STEPS));
    return Number((Math.round((this.low + part * (this.high - this.low)) / step) * step).toPrecision(9));
  }
}

function slider(item: Item, id: string, send: Send): Control {
  const range = new Range(item);
  const track = make("input", { type: "range", min: "0", max: String(STEPS), step: "1", tabIndex: 0 });
  track.setAttribute("aria-label", `${item.name}, slider`);
  const field = make("input", { type: "text", inputMode: "decimal", id, className: "number" });
  field.setAttribute("aria-describedby", `${id}-doc`);
  let held: number | null = null;
  const show = (value: Value): void => {
    if (typeof value !== "number") return;
    held = value;
    if (document.activeElement !== field) field.value = short(value);
    field.removeAttribute("aria-invalid");
    if (document.activeElement !== track || !track.matches(":active")) track.value = String(range.place(value));
    track.setAttribute("aria-valuetext", `${short(value)} ${item.unit}`.trimEnd());
  };
  track.addEventListener("input", () => {
    const value = range.value(Number(track.value));
    field.value = short(value);
    send(value);
  });
  field.addEventListener("change", () => {
    const value = Number(field.value.trim().replace(",", "."));
    const fits = field.value.trim() !== "" && Number.isFinite(value);
    field.setAttribute("aria-invalid", String(!fits));
    if (fits) send(value);
  });
  field.addEventListener("blur", () => held !== null && show(held));
  keyed(field, () => held !== null && show(held));
  return { element: make("div", { className: "slider" }, track, field), show };
}

/** Enter takes what was written, Escape what was there before. */
function keyed(field: HTMLInputElement, restore: () => void): void {
  field.addEventListener("keydown", (event) => {
    if (event.key === "Escape") {
      field.blur();
      restore();
    }
  });
}

/** A number that may be left out: a tick says whether it is there. */
function optional(item: Item, id: string, send: Send): Control {
  const usual = typeof item.value === "number" ? item.value : Math.min(Math.max(1, item.low ?? 0), item.high ?? 1);
  const inner = slider({ ...item, value: usual }, id, send);
  const on = make("input", { type: "checkbox", className: "switch" });
  on.setAttribute("aria-label", `${item.name}: on`);
  const word = make("span", { className: "none" }, "none");
  let last = usual;
  on.addEventListener("change", () => send(on.checked ? last : null));
  return {
    element: make("div", { className: "optional" }, on, inner.element, word),
    show: (value) => {
      on.checked = value !== null;
      inner.element.hidden = value === null;
      word.hidden = value !== null;
      if (typeof value === "number") last = value;
      inner.show(value);
    },
  };
}

function choice(item: Item, id: string, send: Send): Control {
  const select = make("select", { id }, ...item.choices.map((value) => make("option", { value }, value)));
  select.setAttribute("aria-describedby", `${id}-doc`);
  select.addEventListener("change", () => send(select.value));
  return { element: select, show: (value) => void (select.value = String(value)) };
}

function tick(id: string, send: Send): Control {
  const box = make("input", { type: "checkbox", id, className: "switch" });
  box.addEventListener("change", () => send(box.checked));
  return { element: box, show: (value) => void (box.checked = value === true) };
}

function text(id: string, send: Send): Control {
  const field = make("input", { type: "text", id });
  field.addEventListener("change", () => send(field.value));
  return { element: field, show: (value) => void (field.value = String(value ?? "")) };
}

function vector(item: Item, id: string, send: Send): Control {
  const axes = ["x", "y", "z"];
  const fields = axes.map((axis, k) => {
    const field = make("input", { type: "text", inputMode: "decimal", id: k === 0 ? id : `${id}-${axis}` });
    field.setAttribute("aria-label", `${item.name} ${axis}`);
    return field;
  });
  let held: number[] = [];
  const show = (value: Value): void => {
    if (!Array.isArray(value)) return;
    held = value;
    fields.forEach((field, k) => {
      if (document.activeElement !== field) field.value = short(value[k] ?? 0);
      field.removeAttribute("aria-invalid");
    });
  };
  for (const field of fields) {
    field.addEventListener("change", () => {
      const values = fields.map(({ value }) => Number(value.trim().replace(",", ".")));
      const fits = values.every(Number.isFinite);
      field.setAttribute("aria-invalid", String(!fits));
      if (fits) send(values);
    });
    keyed(field, () => show(held));
  }
  const element = make("div", { className: "vector" }, ...fields.flatMap((field, k) => [make("span", {}, axes[k]), field]));
  return { element, show };
}

function fixed(id: string): Control {
  const shown = make("output", { id, className: "fixed" });
  return { element: shown, show: (value) => write(shown, typeof value === "number" ? short(value) : JSON.stringify(value)) };
}

/** A slider of the page's own, for what no parameter says as it is thought of: `unit` and ends are fixed. */
export function ownSlider(name: string, unit: string, doc: string, ends: [number, number], step: number, send: (value: number) => void): Control {
  const id = `field-${++made}`;
  const [low, high] = ends;
  const track = make("input", { type: "range", min: String(low), max: String(high), step: String(step), id });
  const shown = make("output", { className: "number", htmlFor: id } as object);
  const decimals = step < 1 ? 1 : 0;
  track.setAttribute("aria-describedby", `${id}-doc`);
  const tell = (value: number): void => {
    write(shown, number(value, decimals));
    track.setAttribute("aria-valuetext", `${number(value, decimals)} ${unit}`);
  };
  track.addEventListener("input", () => {
    tell(Number(track.value));
    send(Number(track.value));
  });
  const head = make("div", { className: "head" }, make("label", { htmlFor: id, className: "name" }, name), make("span", { className: "unit" }, unit));
  const element = make(
    "div",
    { className: "field", attributes: { "data-name": name } },
    head,
    make("div", { className: "slider" }, track, shown),
    make("p", { className: "doc", id: `${id}-doc` }, doc),
  );
  return {
    element,
    show: (value) => {
      if (typeof value !== "number") return;
      if (!track.matches(":active")) track.value = String(value);
      tell(value);
    },
  };
}
