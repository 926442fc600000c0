"""Controls for the pictures: a `Panel` of sliders and switches, and a `Stepper` through a filter's history.

Only ipywidgets' core widgets, and the picture as PNG in an `Image`: nothing to install in the browser, and
the widget runs without one, so that a test or a cell may say `stepper.slider.value = 7` and look at the picture.
Where there is no kernel (a page on the web, a notebook that has not been run) the last picture stands in its place.
"""

import html
import math

import ipywidgets

from .canvas import Decades, Number, Switch

UNSEEN = "position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%)"  # and read aloud
SPEEDS = {"slow": 800, "normal": 350, "fast": 120}  # ms a half-step


class Panel(ipywidgets.VBox):
    """A picture with a control for each of its `controls`.

    picture : `pictures.canvas.Picture`.
    controls : dict name -> the ipywidgets control, whose `value` may be set from code.
    image, text : the widgets that hold the picture, and its caption with the picture in words for screen readers.
    """

    def __init__(self, picture, **layout):
        self.picture = picture
        self.controls = {name: _control(control) for name, control in picture.controls.items()}
        width = f"{int(picture.figure.bbox.width)}px"
        self.image = ipywidgets.Image(format="png", layout=ipywidgets.Layout(width=width, max_width="100%"))
        self.text = ipywidgets.HTML(layout=ipywidgets.Layout(width=width, max_width="100%"))
        for control in self.controls.values():
            control.observe(self._show, names="value")
        super().__init__(
            [*self._bars(), self.image, self.text],
            layout=ipywidgets.Layout(align_items="flex-start"),
            **layout,
        )
        self._show()

    @property
    def state(self) -> dict:
        """The keyword arguments that the controls stand for now."""
        return {name: control.value for name, control in self.controls.items()}

    def _bars(self):
        """The rows of controls above the picture."""
        return [_row(list(self.controls.values()))] if self.controls else []

    def _show(self, change=None):
        self.image.value = self.picture.png(**self.state)
        caption = self.picture.caption(**self.state)
        # "status": a screen reader reads the caption out whenever it changes. An Image widget has no alternative text.
        self.text.value = (
            f'<div role="status">{html.escape(caption)}</div>'
            f'<div style="{UNSEEN}">{html.escape(self.picture.alt(**self.state))}</div>'
        )

    def __repr__(self):
        """Fixed, so that a notebook's stored text never depends on the picture or on an address."""
        return f"{type(self).__name__}({self.picture.name})"

    def _repr_mimebundle_(self, **kwargs):
        """The live widget, and the still picture for where there is no kernel."""
        bundle = super()._repr_mimebundle_(**kwargs)
        data, metadata = self.picture.still(**self.state)._repr_mimebundle_()
        return {**bundle, "image/png": data["image/png"]}, metadata


class Stepper(Panel):
    """A filter's history in half-steps, first what it predicts, then what it believes after the update.

    Buttons: first, back, play, forward, last. The arrow keys move the slider when it has the focus; Tab
    reaches the buttons and Enter presses them.

    picture : `pictures.canvas.StepPicture`. start : the half-step to begin with.
    slider, play, speed, buttons : the controls; `buttons` is a dict of first, back, forward, last.
    """

    def __init__(self, picture, start=0):
        last = picture.n - 1
        self.slider = ipywidgets.IntSlider(
            start, 0, last, description="half-step", layout=ipywidgets.Layout(width="340px")
        )
        self.play = ipywidgets.Play(
            value=start,
            min=0,
            max=last,
            interval=SPEEDS["normal"],
            show_repeat=False,
            tooltip="play or pause; the square stops at the first half-step",
        )
        self.speed = ipywidgets.Dropdown(
            options=SPEEDS,
            value=SPEEDS["normal"],
            description="speed",
            style={"description_width": "50px"},
            layout=ipywidgets.Layout(width="140px"),
        )
        self.buttons = {
            name: ipywidgets.Button(icon=icon, tooltip=tooltip, layout=ipywidgets.Layout(width="40px"))
            for name, icon, tooltip in (
                ("first", "fast-backward", "first half-step"),
                ("back", "step-backward", "one half-step back"),
                ("forward", "step-forward", "one half-step forward"),
                ("last", "fast-forward", "last half-step"),
            )
        }
        self._press("first", lambda i: 0)
        self._press("back", lambda i: max(i - 1, 0))
        self._press("forward", lambda i: min(i + 1, last))
        self._press("last", lambda i: last)
        # In the browser: pressing play costs the kernel nothing but the pictures.
        ipywidgets.jslink((self.play, "value"), (self.slider, "value"))
        ipywidgets.link((self.speed, "value"), (self.play, "interval"))
        self.slider.observe(self._show, names="value")
        super().__init__(picture)

    @property
    def state(self) -> dict:
        """The half-step `i`, and the controls of the picture."""
        return {"i": self.slider.value, **super().state}

    def _press(self, name, move):
        def pressed(_):
            self.slider.value = move(self.slider.value)

        self.buttons[name].on_click(pressed)

    def _bars(self):
        first, back, forward, last = self.buttons.values()
        return [_row([first, back, self.play, forward, last, self.slider, self.speed]), *super()._bars()]

    def __repr__(self):
        """Fixed, see `Panel`."""
        return f"Stepper({self.picture.name}, {self.picture.n} half-steps)"


def _row(widgets):
    """Widgets side by side, in as many lines as the page needs."""
    return ipywidgets.Box(widgets, layout=ipywidgets.Layout(flex_flow="row wrap", max_width="100%"))


def _control(control):
    """The widget for a `Number` or a `Switch`."""
    if isinstance(control, Switch):
        return ipywidgets.Checkbox(
            control.value, description=control.label, indent=False,
            layout=ipywidgets.Layout(width="auto", margin="2px 20px 2px 2px"),
        )
    if isinstance(control, Decades):
        return ipywidgets.FloatLogSlider(
            control.value,
            min=math.log10(control.low),
            max=math.log10(control.high),
            step=control.step,
            readout_format=".2r",
            description=control.label,
            style={"description_width": "95px"},
            layout=ipywidgets.Layout(width="280px"),
        )
    if isinstance(control, Number):
        slider = ipywidgets.IntSlider if isinstance(control.step, int) else ipywidgets.FloatSlider
        return slider(
            control.value,
            min=control.low,
            max=control.high,
            step=control.step,
            description=control.label,
            style={"description_width": "95px"},
            layout=ipywidgets.Layout(width="280px"),
        )
    raise TypeError(f"a control is a Number or a Switch, got {control!r}")
