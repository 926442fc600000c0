"""Filters over whole drives: the record of a run, the report's pipeline, consistency over many drives, calibration.

What runs the filters of the core and collects what they yield.
"""
