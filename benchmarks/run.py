"""All benchmarks, one after the other: python benchmarks/run.py

Each is a script of its own in this directory, and stores its figures in results/.
"""

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve()


def main():
    """Returns the exit status: 1 when any benchmark failed."""
    failed = []
    for script in sorted(HERE.parent.glob("*.py")):
        if script != HERE:
            print(f"\n=== {script.name}", flush=True)
            if subprocess.run([sys.executable, script]).returncode:
                failed.append(script.name)
    if failed:
        print(f"\nfailed or over their limit: {', '.join(failed)}")
    return int(bool(failed))


if __name__ == "__main__":
    raise SystemExit(main())
