"""A `Panel`: a picture with a slider, a switch, buttons or a list for each of its controls.

The picture is a PNG, the controls are native inputs (`control.js`); the widget runs without a browser, so that a test
or a cell may say `panel.controls["depth"].value = 7` and look at the picture. Where there is no kernel (a page on the
web, a notebook that has not been run) the last picture stands in its place.
"""

import html
from dataclasses import asdict
from pathlib import Path

import anywidget
import ipywidgets
import traitlets

from .canvas import DPI, Choice, Decades, Number, Switch


class _Image(anywidget.AnyWidget):
    """A PNG, `value`, with its alternative text, `alt`, which ipywidgets' own Image has not."""

    _esm = """export default { render({ model, el }) {
      const image = el.appendChild(Object.assign(new Image(), { className: "widget-image", style: "width:100%" }));
      const show = () => {
        URL.revokeObjectURL(image.src);
        Object.assign(image, { alt: model.get("alt"), src: URL.createObjectURL(new Blob([model.get("value")])) });
      };
      model.on("change:value", show);
      show();
    } };"""
    value = traitlets.Bytes().tag(sync=True)
    alt = traitlets.Unicode().tag(sync=True)


class Control(anywidget.AnyWidget):
    """The input for a `Number`, a `Switch` or a `Choice`, with its label; `value` may be set from code.

    A number outside the range becomes the end of the range; it is a whole number where the step is one.
    Raises TypeError for anything else than these three, and `TraitError` for a name that is not in the list.
    """

    _esm = Path(__file__).with_name("control.js")
    spec = traitlets.Dict().tag(sync=True)
    value = traitlets.Any().tag(sync=True)

    def __init__(self, control: Number | Switch | Choice):
        if not isinstance(control, Number | Switch | Choice):
            raise TypeError(f"a control is a Number, a Switch or a Choice, got {control!r}")
        self.control = control
        super().__init__(spec=asdict(control) | {"kind": type(control).__name__.lower()}, value=control.value)

    @traitlets.validate("value")
    def _in_range(self, proposal):
        value, control = proposal.value, self.control
        if isinstance(control, Switch):
            return bool(value)
        if isinstance(control, Choice):
            if value not in control.names:
                raise traitlets.TraitError(f"{control.label}: {value!r} is not one of {', '.join(control.names)}")
            return value
        value = min(max(value, control.low), control.high)
        whole = isinstance(control.step, int) and not isinstance(control, Decades)
        return round(value) if whole else float(value)

    def __repr__(self):
        """Fixed, see `Panel`."""
        return f"Control({self.control.label})"


class Panel(ipywidgets.VBox):
    """A picture with a control for each of its `controls`.

    picture : `canvas.Picture`.
    controls : dict name -> its `Control`, whose `value` may be set from code.
    image, text : the widgets that hold the picture, and its caption.
    """

    def __init__(self, picture, **layout):
        self.picture = picture
        self.controls = {name: Control(control) for name, control in picture.controls.items()}
        width = f"{int(DPI * picture.size[0])}px"
        self.image = _Image(layout=ipywidgets.Layout(width=width, max_width="100%"))
        self.text = ipywidgets.HTML(layout=ipywidgets.Layout(width=width, max_width="100%"))
        row = ipywidgets.Layout(flex_flow="row wrap", align_items="center", width=width, max_width="100%")
        for control in self.controls.values():
            control.observe(self._show, names="value")
        super().__init__([ipywidgets.Box(list(self.controls.values()), layout=row), self.image, self.text],
                         layout=ipywidgets.Layout(align_items="flex-start"), **layout)
        self._show()

    @property
    def state(self) -> dict:
        """The keyword arguments that the controls stand for now."""
        return {name: control.value for name, control in self.controls.items()}

    def _show(self, change=None):
        with self.image.hold_sync():
            self.image.alt, self.image.value = self.picture.alt(**self.state), self.picture.png(**self.state)
        # "status": a screen reader reads the caption out whenever it changes.
        caption = html.escape(self.picture.caption(**self.state))
        self.text.value = f'<div role="status" style="line-height: 1.4">{caption}</div>'

    def __repr__(self):
        """Fixed, so that a notebook's stored text never depends on the picture or on an address."""
        return f"{type(self).__name__}({self.picture.name})"

    def _repr_mimebundle_(self, **kwargs):
        """The live widget, and the still picture for where there is no kernel.

        The metadata are also those of the picture: with them Colab loads what it is made of, which no box asks for.
        """
        bundle = super()._repr_mimebundle_(**kwargs)
        data, metadata = self.picture.still(**self.state)._repr_mimebundle_()
        _, loading = self.image._repr_mimebundle_() or ({}, {})
        return {**(bundle or {}), "image/png": data["image/png"]}, metadata | loading
