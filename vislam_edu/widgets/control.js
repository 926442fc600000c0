/**
 * Native inputs with a label: a range for a number, a checkbox for a switch, a list for a choice, or buttons (radio
 * inputs) where it has few names. `value` is what Python sees. On a logarithmic scale the input holds the power of ten.
 */
const FEW = 4; // names of a choice that stand side by side

/** An element with properties and children. JupyterLab and Notebook 7 leave an input with this mark its keys. */
function make(tag, properties, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.setAttribute("data-lm-suppress-shortcuts", "true");
  element.append(...children);
  return element;
}

function render({ model, el }) {
  const { label, kind, low, high, step, names = [] } = model.get("spec");
  const log = kind === "decades", tick = kind === "switch", list = kind === "choice", few = list && names.length <= FEW;
  const box = document.createElement(few ? "div" : "label"), name = document.createElement("span");
  const shown = document.createElement("output"), group = `choice ${Math.random()}`; // two views of one control are two groups
  const inputs = few ? names.map((value) => make("input", { type: "radio", name: group, value, style: "margin:0" }))
    : [list ? make("select", {}, ...names.map((text) => new Option(text))) : make("input", { type: tick ? "checkbox" : "range" })];
  const [input] = inputs;
  box.style.cssText = "display:inline-flex;flex-wrap:wrap;gap:6px;align-items:center;margin:2px 14px 2px 2px;"
    + "white-space:nowrap;font:13px var(--jp-ui-font-family,system-ui,sans-serif);color:var(--jp-ui-font-color1,inherit)";
  name.textContent = label;
  if (few) {
    Object.assign(box, { role: "radiogroup", ariaLabel: label });
    box.append(name, ...inputs.map((one) => make("label", {}, one, one.value)));
  } else box.append(...(tick ? [input, name] : [name, input, shown]));
  if (!list && !tick) {
    Object.assign(input, { step, min: log ? Math.log10(low) : low, max: log ? Math.log10(high) : high });
    input.style.width = "150px";
    shown.style.cssText = "min-width:4em;font-variant-numeric:tabular-nums";
  }
  const show = () => {
    const value = model.get("value");
    for (const one of few ? inputs : []) {
      one.checked = one.value === value;
      one.parentElement.style.cssText = "display:inline-flex;gap:5px;align-items:center;padding:3px 8px;cursor:pointer;"
        + `border:1px solid var(--jp-border-color1,#bbb);border-radius:3px;${one.checked ? "border-color:#1a73e8;box-shadow:inset 0 0 0 1px #1a73e8" : ""}`;
    }
    if (tick) input.checked = value;
    else if (!few) input.value = log ? Math.log10(value) : value;
    if (!list && !tick) shown.textContent = String(Number(value.toPrecision(log ? 2 : 6))).replace("-", "−");
  };
  box.addEventListener("input", ({ target }) => {
    model.set("value", tick ? target.checked : list ? target.value : log ? 10 ** Number(target.value) : Number(target.value));
    model.save_changes();
  });
  box.addEventListener("keydown", (event) => { if (event.key !== "Tab" && event.key !== "Escape") event.stopPropagation(); });
  model.on("change:value", show);
  el.append(box);
  show();
  return () => model.off("change:value", show);
}

export default { render };
