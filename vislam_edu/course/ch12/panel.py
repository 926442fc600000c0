"""Chapter 12: the search for pairs that fit together, one node of its tree after the other."""

import numpy as np
from matplotlib.collections import LineCollection

from ... import kalman
from ...association import Candidates, branch_and_bound
from ...plots.style import COLOURS
from ...widgets.canvas import Number, Picture
from ..panels import add_axes, fit_equal, legend_above, moving_line


class BranchesPicture(Picture):
    """The tree of joint compatibility as far as the search has come, and the pairs of its last node on the map.

    both : `association.Candidates`. gate : probability of the gates, as in `branch_and_bound`.
    nodes : list of `association.Node`, in the order of the search.
    """

    name = "branch and bound"
    size = (8.4, 4.0)

    def __init__(self, both: Candidates, gate: float = 0.99):
        self.both, self.gate = both, gate
        self.nodes = list(branch_and_bound(both, gate))
        if not self.nodes:
            raise ValueError("no pair passes its own gate, so there is no tree to search")
        self.controls = {"node": Number("node", len(self.nodes), 1, len(self.nodes), 1)}
        self.depth = np.array([len(node.pairs) for node in self.nodes])
        self.fits = np.array([node.compatible for node in self.nodes])
        last: dict[tuple, int] = {}  # the node of each set of pairs
        self.parents = []
        for k, node in enumerate(self.nodes):
            self.parents.append(last.get(tuple(node.pairs[:-1]), -1))
            last[tuple(node.pairs)] = k
        super().__init__()

    def build(self):
        self.tree = add_axes(self, (0.06, 0.14, 0.36, 0.68), "Sets of pairs, in the order of the search",
                             "node", "pairs", xlim=(0, len(self.nodes) + 1), ylim=(self.depth.max() + 0.5, -0.5),
                             yticks=np.arange(self.depth.max() + 1))
        self.edges = self.moves(self.tree.add_collection(
            LineCollection([], colors=COLOURS["faded"], linewidths=0.9), autolim=False))
        self.fitting = moving_line(self, self.tree, "o", ms=5, color=COLOURS["accepted"], label="fits together")
        self.ended = moving_line(self, self.tree, "x", ms=5, color=COLOURS["rejected"], label="does not")
        self.here = moving_line(self, self.tree, "o", ms=12, mfc="none", mew=1.5, color=COLOURS["truth"],
                                label="this node")
        legend_above(self.tree, [self.fitting, self.ended, self.here])

        new, old = self.both.landmarks[:len(self.both.new)], self.both.landmarks[len(self.both.new):]
        self.map = add_axes(self, (0.5, 0.14, 0.49, 0.68), "Its pairs on the map", "x (m)", "y (m)")
        tried = [np.unique([pair[side] for node in self.nodes for pair in node.pairs]) for side in (0, 1)]
        fit_equal(self.map, new[tried[0], :2], old[tried[1], :2], margin=2.0)
        for ids, rows, points, colour, beside, side in (
                (self.both.new, tried[0], new, "posterior", 4, "left"),
                (self.both.old, tried[1], old, "dead_reckoning", -4, "right")):
            for row in rows:
                self.map.annotate(str(ids[row]), points[row, :2], xytext=(beside, 0), textcoords="offset points",
                                  fontsize=9, color=COLOURS[colour], ha=side, va="center", clip_on=True)
        self.lines = self.moves(self.map.add_collection(LineCollection([], linewidths=2.5), autolim=False))
        (olds,) = self.map.plot(*old[:, :2].T, "s", ms=3, color=COLOURS["dead_reckoning"], label="old")
        (news,) = self.map.plot(*new[:, :2].T, "o", ms=3, color=COLOURS["posterior"], label="new")
        legend_above(self.map, [news, olds])
        self.new, self.old = new, old

    def draw(self, node):
        place = np.column_stack([np.arange(node) + 1, self.depth[:node]])
        parents = np.concatenate([place, np.zeros((1, 2))])[self.parents[:node]]  # the last row is the root
        self.edges.set_segments(np.stack([parents, place], axis=1))
        self.fitting.set_data(*place[self.fits[:node]].T)
        self.ended.set_data(*place[~self.fits[:node]].T)
        self.here.set_data(*place[-1:].T)
        pairs = self.nodes[node - 1].pairs
        self.lines.set_segments([np.stack([self.new[i, :2], self.old[j, :2]]) for i, j in pairs])
        self.lines.set_color(COLOURS["accepted" if self.fits[node - 1] else "rejected"])

    def caption(self, node):
        here, k = self.nodes[node - 1], len(self.nodes[node - 1].pairs)
        verdict = "fits" if here.compatible else "does not fit: the branch ends"
        pairs = "1 pair" if k == 1 else f"{k} pairs"
        last = "{} with {}".format(*(ids[row] for ids, row in zip((self.both.new, self.both.old), here.pairs[-1])))
        return (f"Node {node} of {len(self.nodes)}, {pairs}, the last {last}: joint NIS {here.nis:.1f}, threshold "
                f"{kalman.gate_threshold(self.gate, 3 * k):.1f}, {verdict}. Best so far: {len(here.best)}.")

    def alt(self, node):
        return ("Left, the tree of sets of pairs in the order of the search; right, the map of new and old landmarks "
                f"with a line for each pair of this node. {self.caption(node)}")
