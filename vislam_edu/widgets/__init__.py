"""What a student moves: steppers through a filter's history, panels of sliders, and the pictures that they show.

Here lives everything that reacts. A widget works without a browser too, so that a test can move it.
"""

from .stepper import SPEEDS, UNSEEN, Panel, Stepper

__all__ = ["SPEEDS", "UNSEEN", "Panel", "Stepper"]
