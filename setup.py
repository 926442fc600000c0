"""What pyproject.toml cannot say: a wheel also carries drives, notebooks, their pages and stored results."""

import shutil
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.build_py import build_py

HERE = Path(__file__).parent
SHIPPED = ("data/*.npz", "notebooks/*.ipynb", "notebooks/images/*", "benchmarks/results/*.json",
           "docs/notation.md", "docs/reading.md")


class BuildWithNotebooks(build_py):
    """Copies what `recordings.shipped` finds into the built package; an editable one finds the clone's own."""

    def run(self):
        super().run()
        if not self.editable_mode:
            for path in (path for pattern in SHIPPED for path in HERE.glob(pattern)):
                target = Path(self.build_lib, "vislam_edu", "shipped", path.relative_to(HERE))
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)


class EditableWithDataFiles(Distribution):
    """An editable install has JupyterLab's extension, too: setuptools asks a method of another name for its files."""

    has_data = Distribution.has_data_files


setup(cmdclass={"build_py": BuildWithNotebooks}, distclass=EditableWithDataFiles)
