"""One notebook in a fresh kernel: what storing outputs and grading share."""

import asyncio
from pathlib import Path
from typing import Any


def execute(notebook: Any, folder: Path, environment: dict[str, str], limit: float | None = None,
            **options: Any) -> None:
    """Run the cells of a notebook, in place, in a kernel that starts in `folder` with this environment.

    limit : s, for the whole notebook. options : of `nbclient.NotebookClient`.
    Raises TimeoutError when the time is up, and what nbclient raises.
    """
    from nbclient import NotebookClient
    from nbclient.exceptions import DeadKernelError

    client = NotebookClient(notebook, kernel_name="python3", record_timing=False,
                            extra_arguments=["--log-level=ERROR"],  # not its own log; warnings are outputs
                            resources={"metadata": {"path": str(folder)}}, **options)

    async def run() -> None:
        clock = asyncio.timeout(limit)
        try:
            async with clock:
                await client.async_execute(env=environment)
        except DeadKernelError:  # a kernel that is ended because the time is up counts as dead too
            if clock.expired():
                raise TimeoutError from None
            raise

    asyncio.run(run())
