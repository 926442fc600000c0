"""The course's commands, each a module here. `vislam_edu.cli` finds them by the entry point in pyproject.toml."""

COMMANDS = {
    "start": "copy the notebooks into a folder and open them",
    "hand-out": "copy the notebooks into a folder for students, stubs empty, or for teachers",
    "exercises": "grade submitted notebooks, list the mistakes that checks know",
    "clinic": "an examination with unlabelled faults: serve its pages, grade the answers",
}
