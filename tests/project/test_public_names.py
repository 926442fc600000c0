"""The names that the package offers, what importing it costs, and the README's table of its rooms."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import vislam_edu

ROOT = Path(__file__).resolve().parents[2]


def test_all_is_the_list_in_the_docstring_and_what_dir_shows():
    table = vislam_edu.__doc__.partition("in the order of the notebooks:")[2].partition("\n\nA name")[0]
    listed = [line.split()[0] for line in table.splitlines() if line.strip()]
    assert sorted(listed) == sorted(vislam_edu.__all__) == dir(vislam_edu)


@pytest.mark.parametrize("name", vislam_edu.__all__)
def test_every_name_is_there_and_explained(name):
    assert getattr(vislam_edu, name).__doc__


def test_another_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        vislam_edu.nothing  # noqa: B018


def rows_of_readme(after):
    text = (ROOT / "README.md").read_text(encoding="utf-8").partition("## The package")[2].partition("\n## ")[0]
    return sorted(re.findall(r"(?m)^\| `(\w+)/`", text.partition(after)[2].partition("\n\n|")[2].partition("\n\n")[0]))


def test_the_readme_has_one_row_a_room_of_the_helper_and_of_the_course():
    rooms = {path.parent.name for path in (ROOT / "vislam_edu").glob("*/__init__.py")}
    assert rows_of_readme("Two floors") == sorted(rooms - {"course"})
    folders = {path.parent.name for path in (ROOT / "vislam_edu" / "course").glob("*/__init__.py")}
    assert rows_of_readme("The course, ") == sorted({re.sub(r"^ch\d\d$", "chNN", name) for name in folders})


def test_the_readme_names_every_core_file_once_and_the_page_has_them_in_its_order():
    table = (ROOT / "README.md").read_text(encoding="utf-8").partition("## The package")[2].partition("\n## ")[0]
    [core] = [line for line in table.splitlines() if line.startswith("| the core")]
    files = {path.stem for path in (ROOT / "vislam_edu").glob("*.py")} - {"__init__", "__main__"}
    names = re.findall(r"`(\w+)`", core)
    assert sorted(names) == sorted(files)
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    assert re.findall(r"automodule:: vislam_edu\.(\w+)", page) == names


def test_importing_the_package_changes_nothing():
    code = ("import numpy, scipy.linalg, matplotlib, threadpoolctl;"
            "now = lambda: (sorted(map(str, threadpoolctl.threadpool_info())), dict(matplotlib.rcParams));"
            "before = now();"
            "import vislam_edu; vislam_edu.window_slam, vislam_edu.plots, vislam_edu.audit, vislam_edu.widgets;"
            "assert before == now()")  # sorted: threadpoolctl lists the libraries in any order
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_drawing_leaves_the_settings_of_matplotlib_alone():
    code = ("import io, matplotlib; before = dict(matplotlib.rcParams);"
            "from vislam_edu import audit, load, plots, simulate; figure, axes = plots.new_figure();"
            "plots.finish(figure, 'title').savefig(io.BytesIO(), format='png');"
            "audit.audit(simulate.street_loop(frames=20, visible=15)).figure();"
            "assert before == dict(matplotlib.rcParams)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_a_filter_limits_threads_while_it_works_and_not_between_frames():
    from threadpoolctl import threadpool_info, threadpool_limits

    from vislam_edu import Noise, load, window_slam

    def threads():
        return {info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas"}

    inside = set()

    def process_frame(*arguments):
        inside.update(threads())
        return window_slam.correlated(*arguments)

    with threadpool_limits(limits=2, user_api="blas"):
        for _, _step in zip(range(3), window_slam.run(load("first_steps"), Noise(), process_frame=process_frame)):
            assert threads() == {2}
    assert inside == {1}
