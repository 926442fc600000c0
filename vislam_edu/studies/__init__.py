"""Filters at work over whole drives: the report's pipeline, many drives, observability, and filters with one mistake.

Here lives what runs the filters of the core and collects what they yield. Nothing here draws.
"""
