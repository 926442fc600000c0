"""Submitted notebooks: run, collected, reported."""
