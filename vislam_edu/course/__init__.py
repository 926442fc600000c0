"""The course on top of the helper: what the notebooks need and nobody else. The helper never imports it.

chNN            a folder a chapter: its `exercises`, `figures` and `panel`, where it has them
checks          what judges and explains an answer
exercises       all exercises of all chapters, and `check`, `hint`, `solution`
grading         submitted notebooks, one, a folder, a class
clinic          filters and recordings with an unlabelled fault, the tests that find it, the answers
cli             the commands `start`, `exercises`, `clinic`
"""
