"""Where strangers' notebooks can be run: bubblewrap, podman or docker, without network, the submissions read-only."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from ...cli.arguments import OptionError

IMAGE = "vislam_edu"  # for podman and docker, which need one with this package installed
_PROBE = ["-c", "import vislam_edu.course.exercises, IPython"]


@dataclass(frozen=True)
class Sandbox:
    """A program that isolates others. program : "bwrap", "podman" or "docker". image : for the latter two."""

    program: str
    image: str = IMAGE

    def command(self, python: list[str], folder: Path, scratch: Path, hidden: Path, passed: dict[str, str],
                name: str) -> list[str]:
        """The command line that runs Python with the arguments `python`, isolated.

        folder : can be read and nothing else. scratch : can be written too. hidden : folder that holds all submissions,
        of which only `folder` is to be seen. passed : environment variables. name : of the container.
        """
        if self.program == "bwrap":
            return self._bubblewrap(python, folder, scratch, hidden)
        user = ["--user", f"{os.getuid()}:{os.getgid()}"]  # who owns scratch
        if self.program == "podman":
            user.append("--userns=keep-id")
        variables = [f"--env={key}={value}" for key, value in ({"HOME": "/tmp"} | passed).items()]
        return [self.program, "run", "--rm", "--init", "--interactive", "--name", name, "--network", "none",
                "--read-only", "--tmpfs", "/tmp", "--memory", "4g", "--pids-limit", "256", "--cap-drop", "ALL",
                "--security-opt", "no-new-privileges", "--mount", f"type=bind,source={folder},target={folder},readonly",
                "--mount", f"type=bind,source={scratch},target={scratch}", *user, *variables, self.image,
                "python", *python]

    def _bubblewrap(self, python, folder, scratch, hidden):
        """The system read-only, without homes, other submissions and other processes; only the loopback interface."""
        package = Path(__file__).resolve().parents[2]
        needed = dict.fromkeys(str(path) for path in (sys.base_prefix, sys.prefix, package, folder))
        return ["bwrap", "--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc", "--tmpfs", "/tmp",
                "--tmpfs", str(Path.home()), "--tmpfs", str(hidden),
                *(part for path in needed for part in ("--ro-bind", path, path)), "--bind", str(scratch), str(scratch),
                "--unshare-all", "--die-with-parent", "--new-session", "--", sys.executable, *python]

    def end(self, name: str) -> None:
        """End a container: it lives on when the program that started it is ended."""
        if self.program != "bwrap":
            subprocess.run([self.program, "rm", "--force", name], capture_output=True, check=False)


def find(folder: Path, scratch: Path, image: str = IMAGE) -> Sandbox:
    """The first sandbox in which this package can be imported, tried with these folders. Raises OptionError."""
    problems = []
    for program in ("bwrap", "podman", "docker"):
        if shutil.which(program) is None:
            problems.append(f"{program} is not installed")
            continue
        sandbox = Sandbox(program, image)
        done = subprocess.run(sandbox.command(_PROBE, folder, scratch, folder, {}, f"vislam_edu-{scratch.name}"),
                              capture_output=True, text=True, errors="replace", check=False)
        if done.returncode == 0:
            return sandbox
        lines = done.stderr.strip().splitlines() or ["it fails without a word"]
        problems.append(f"{program}: {lines[-1]}")
    raise OptionError("exercises --sandbox: no sandbox works here (" + "; ".join(problems) + ")")
