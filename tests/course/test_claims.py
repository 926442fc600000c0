"""What the chapters claim about filters, rules and faults holds on seeds that no chapter was written with."""

import json
from pathlib import Path

import pytest
from claims import CLAIMS, SEEDS
from whole import WHOLE

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: f"{claim.chapter}-{claim.holds.__name__}")
def test_a_claim_holds_over_seeds(claim):
    seeds = SEEDS if WHOLE else SEEDS[len(SEEDS) - claim.few:]
    if not seeds:
        pytest.skip("takes long: VISLAM_EDU_WHOLE=1 tries it over all seeds")
    held = [seed for seed in seeds if claim.holds(seed)]
    assert len(held) >= int(claim.share * len(seeds)), f"{claim.sentence!r}: holds on {held} of {list(seeds)}"


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: f"{claim.chapter}-{claim.holds.__name__}")
def test_a_claim_is_what_the_chapter_says(claim):
    [path] = NOTEBOOKS.glob(f"{claim.chapter}_*.ipynb")
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    prose = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    assert " ".join(claim.sentence.split()) in " ".join(prose.split())
