"""The two notebook cells of an exercise, with the metadata by which nbgrader knows them.

The stub is a solution cell: `nbgrader generate_assignment` keeps its signature and docstring and empties what
stands between the marks. The check is a locked test cell worth a point; under nbgrader it raises when it is not
passed.
"""

from .exercise import Exercise

POINTS = 1


def source(exercise: Exercise) -> tuple[str, str]:
    """The text of the stub cell and of the check cell."""
    name = exercise.name
    return exercise.stub.rstrip(), f"from vislam_edu.exercises import check\n\ncheck.{name}({name})"


def pair(exercise: Exercise) -> list:
    """The stub cell and the check cell as notebook nodes, their ids made of the exercise's name."""
    from nbformat import v4

    name = exercise.name
    stub, test = source(exercise)
    common = {"schema_version": 3, "task": False}
    return [
        v4.new_code_cell(stub, id=name.replace("_", "-"), metadata={"nbgrader": common | {
            "grade": False, "grade_id": name, "locked": False, "solution": True}}),
        v4.new_code_cell(test, id="check-" + name.replace("_", "-"), metadata={"nbgrader": common | {
            "grade": True, "grade_id": f"check_{name}", "locked": True, "points": POINTS, "solution": False}}),
    ]
