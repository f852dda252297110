/** Labelled controls of the panel. Each shows what `get` says whenever the panel is refreshed. */

export interface Control {
  element: HTMLElement;
  refresh(): void;
}

let ids = 0;

/** An element that the page has from its beginning. */
export function byId<Type extends HTMLElement = HTMLElement>(id: string): Type {
  return document.getElementById(id) as Type;
}

/** An element with properties, classes and children. */
export function make<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag, properties: Partial<Record<string, string | boolean>> = {}, ...children: (Node | string)[]
): HTMLElementTagNameMap[Tag] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (typeof value === "boolean") {
      element.toggleAttribute(name, value);
    } else if (value !== undefined) {
      element.setAttribute(name, value);
    }
  }
  element.append(...children);
  return element;
}

/** Have an element say something; what it says already is not painted anew. */
export function tell(element: Element, text: string): void {
  if (element.textContent !== text) {
    element.textContent = text;
  }
}

function labelled(label: string, input: HTMLElement, output?: HTMLElement): HTMLElement {
  ids += 1;
  input.id = `control-${ids}`;
  return make("div", { class: output === undefined ? "row pair" : "row" },
    make("label", { for: input.id, title: label }, label), input, ...(output === undefined ? [] : [output]));
}

interface SliderOptions {
  min: number;
  max: number;
  step: number | "any";
  get: () => number;
  set: (value: number) => void;
  show?: (value: number) => string;
  /** The number beside the slider, where it can be typed: also one that the slider does not reach. */
  typed?: { get: () => number; set: (value: number) => void };
}

/** A slider with its value beside it. */
export function slider(label: string, options: SliderOptions): Control {
  const { min, max, step, get, set, show = plain, typed } = options;
  const input = make("input", { type: "range", min: String(min), max: String(max), step: String(step) });
  const number = typed === undefined ? null : numberField(`${label}, as a number`, typed.get, (value) => {
    typed.set(value);
    refresh();
  });
  const output = number?.element ?? make("output");
  const refresh = (): void => {
    const value = get();
    const shown = typed === undefined ? show(value) : plain(typed.get());
    if (document.activeElement !== input || Number(input.value) !== value) {
      input.value = String(value);
    }
    if (number === null) {
      tell(output, shown);
    }
    number?.refresh();
    input.setAttribute("aria-valuetext", shown);
  };
  input.addEventListener("input", () => {
    set(Number(input.value));
    refresh();
  });
  return { element: labelled(label, input, output), refresh };
}

/** A field for a number; what is no number is not taken. */
function numberField(label: string, get: () => number, set: (value: number) => void): Control {
  const field = make("input", { "type": "text", "class": "number", "aria-label": label, "autocomplete": "off" });
  const refresh = (): void => {
    if (document.activeElement !== field) {
      field.value = plain(get());
    }
  };
  field.addEventListener("change", () => {
    const value = Number(field.value.trim().replace(",", "."));
    if (field.value.trim() !== "" && Number.isFinite(Math.fround(value))) {
      set(value);
    }
    field.value = plain(get());
  });
  return { element: field, refresh };
}

/** A number as short as it says enough. */
export function plain(value: number, digits = 3): string {
  const size = Math.abs(value);
  if (Number.isInteger(value) && size < 1e6) {
    return String(value);
  }
  return size >= 1e-3 && size < 1e6 ? String(Number(value.toPrecision(digits))) : value.toExponential(digits - 1).replace("+", "");
}

/** A choice of one out of several, of which some may be there at times only. */
export function choice<Value extends string>(
  label: string, options: readonly (readonly [Value, string])[], get: () => Value, set: (value: Value) => void,
  enabled: (value: Value) => boolean = () => true,
): Control {
  const made = options.map(([value, text]) => make("option", { value }, text));
  const select = make("select", {}, ...made);
  select.addEventListener("change", () => {
    set(select.value as Value);
  });
  return {
    element: labelled(label, select), refresh: () => {
      options.forEach(([value], i) => {
        made[i]!.disabled = !enabled(value);
      });
      select.value = get();
    },
  };
}

/** A box to tick. */
export function check(label: string, get: () => boolean, set: (value: boolean) => void): Control {
  const input = make("input", { type: "checkbox" });
  input.addEventListener("change", () => {
    set(input.checked);
  });
  return {
    element: make("label", { class: "check" }, input, label), refresh: () => {
      input.checked = get();
    },
  };
}

/** A colour. */
export function colour(label: string, get: () => [number, number, number], set: (rgb: [number, number, number]) => void): Control {
  const input = make("input", { type: "color" });
  input.addEventListener("input", () => {
    set([1, 3, 5].map((at) => parseInt(input.value.slice(at, at + 2), 16) / 255) as [number, number, number]);
  });
  return {
    element: labelled(label, input), refresh: () => {
      input.value = `#${get().map((part) => Math.round(255 * part).toString(16).padStart(2, "0")).join("")}`;
    },
  };
}

/** Buttons beside each other, whose labels may change. */
export function buttons(...entries: { label: string | (() => string); act: () => void; enabled?: () => boolean }[]): Control {
  const made = entries.map(({ label, act }) => {
    const button = make("button", { type: "button" }, typeof label === "string" ? label : label());
    button.addEventListener("click", act);
    return button;
  });
  return {
    element: make("div", { class: "buttons" }, ...made), refresh: () => {
      entries.forEach(({ label, enabled }, i) => {
        tell(made[i]!, typeof label === "string" ? label : label());
        made[i]!.disabled = enabled !== undefined && !enabled();
      });
    },
  };
}

/** A text that changes. */
export function note(text: () => string, className = "note"): Control {
  const element = make("p", { class: className });
  return {
    element, refresh: () => {
      tell(element, text());
      element.hidden = element.textContent === "";
    },
  };
}

/** Controls that belong together; `shown` false hides them. */
export function group(title: string, controls: Control[], shown: () => boolean = () => true): Control {
  ids += 1;
  const heading = make("h3", { id: `group-${ids}` }, title);
  const element = make("section", { role: "group", "aria-labelledby": heading.id }, heading,
    ...controls.map((control) => control.element));
  return {
    element, refresh: () => {
      element.hidden = !shown();
      if (!element.hidden) {
        controls.forEach((control) => control.refresh());
      }
    },
  };
}

/** A control that is there only at times. */
export function only(shown: () => boolean, control: Control): Control {
  return {
    element: control.element, refresh: () => {
      control.element.hidden = !shown();
      control.refresh();
    },
  };
}
