/**
 * One native input with its label: a range for a number, a checkbox for a switch, a list for a choice. `value` is what Python sees.
 * On a logarithmic scale the input holds the power of ten.
 */
function render({ model, el }) {
  const { label, kind, low, high, step, names } = model.get("spec");
  const log = kind === "log", tick = kind === "switch", list = kind === "choice";
  const box = document.createElement("label"), input = document.createElement(list ? "select" : "input");
  const name = document.createElement("span"), shown = document.createElement("output");
  input.setAttribute("data-lm-suppress-shortcuts", "true"); // JupyterLab and Notebook 7 then leave it its keys
  box.style.cssText = "display:inline-flex;gap:6px;align-items:center;margin:2px 14px 2px 2px;white-space:nowrap;"
    + "font:13px var(--jp-ui-font-family,system-ui,sans-serif);color:var(--jp-ui-font-color1,inherit)";
  name.textContent = label;
  if (tick) {
    input.type = "checkbox";
    box.append(input, name);
  } else if (list) {
    input.append(...names.map((text) => new Option(text)));
    box.append(name, input);
  } else {
    Object.assign(input, { type: "range", step, min: log ? Math.log10(low) : low, max: log ? Math.log10(high) : high });
    input.style.width = "150px";
    shown.style.cssText = "min-width:4em;font-variant-numeric:tabular-nums";
    box.append(name, input, shown);
  }
  const show = () => {
    const value = model.get("value");
    if (tick) input.checked = value;
    else if (list) input.value = value;
    else input.value = log ? Math.log10(value) : value;
    shown.textContent = tick || list ? "" : String(Number(value.toPrecision(log ? 2 : 6))).replace("-", "−");
  };
  input.addEventListener("input", () => {
    model.set("value", tick ? input.checked : list ? input.value : log ? 10 ** Number(input.value) : Number(input.value));
    model.save_changes();
  });
  box.addEventListener("keydown", (event) => { if (event.key !== "Tab" && event.key !== "Escape") event.stopPropagation(); });
  model.on("change:value", show);
  el.append(box);
  show();
  return () => model.off("change:value", show);
}

export default { render };
