"""The tree as a picture or as text, drawn from the factories alone: no robot, no connection."""

from collections.abc import Iterator
from pathlib import Path

import py_trees
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence

from behaviours.conditions import Condition
from behaviours.job import JobLeaf
from behaviours.recover import Recover


class AsAbove(Behaviour):
    """Stands for a branch that was drawn already."""

    def __init__(self, branch: Behaviour) -> None:
        super().__init__(f"{branch.name}, as above")

    def update(self) -> Status:
        return Status.INVALID


_KINDS = (
    (AsAbove, "…", "#ffffff"),
    (Recover, "↻", "#e8d5f2"),
    (Sequence, "→", "#dfe7f0"),
    (Selector, "?", "#d5ecec"),
    (py_trees.decorators.Decorator, "◇", "#eeeeee"),
    (Condition, "¿", "#fff3cc"),
    (JobLeaf, "▶", "#d9efd4"),
    (Behaviour, "•", "#f4f4f4"),
)
_ROW, _INDENT, _SIZE = 0.30, 0.32, 9
_FOLDED = 4
"""Nodes that a branch must have to be folded."""

Shape = tuple[type, str, tuple["Shape", ...]]


def folded(root: Behaviour) -> Behaviour:
    """A tree that is only to be drawn, its branches that stand there again replaced by one line each."""
    drawn: set[Shape] = set()

    def fold(node: Behaviour) -> None:
        for place, child in enumerate(node.children):
            shape = _shape(child)
            if shape in drawn:
                node.children[place] = AsAbove(child)
                continue
            if sum(1 for _ in child.iterate()) >= _FOLDED:
                drawn.add(shape)
            fold(child)

    fold(root)
    return root


def _shape(node: Behaviour) -> Shape:
    return type(node), node.name, tuple(_shape(child) for child in node.children)


def as_text(root: Behaviour) -> str:
    """The tree in box-drawing characters."""
    return str(py_trees.display.unicode_tree(root))


def as_dot(root: Behaviour) -> str:
    """The tree for graphviz."""
    return str(py_trees.display.dot_tree(root).to_string())


def draw(root: Behaviour, path: Path) -> None:
    """The tree as ``.svg`` or ``.png``: one row a node, children indented, shape and colour by kind."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = list(_rows(root))
    depth = max(level for _, level, _ in rows)
    figure = Figure(figsize=(depth * _INDENT + 4.5, len(rows) * _ROW + 0.9))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_xlim(0, depth * _INDENT + 4.5)
    axes.set_ylim(len(rows) * _ROW + 0.6, -0.3)
    for row, (node, level, parent) in enumerate(rows):
        x, y = 0.25 + level * _INDENT, row * _ROW
        if parent is not None:
            stem = x - _INDENT / 2
            axes.plot([stem, stem, x - 0.05], [parent * _ROW + 0.12, y, y], color="#9aa5b1", lw=0.8, zorder=0)
        symbol, colour = next((symbol, colour) for kind, symbol, colour in _KINDS if isinstance(node, kind))
        box = {"boxstyle": "round,pad=0.25", "facecolor": colour, "edgecolor": "#7b8794", "linewidth": 0.6}
        axes.text(x, y, f"{symbol}  {node.name}", va="center", ha="left", size=_SIZE, bbox=box, family="DejaVu Sans")
    legend = "→ in order   ? first that works   ↻ recover   ◇ decorator   ¿ condition   ▶ job   • at once   … as above"
    axes.text(0.25, len(rows) * _ROW + 0.25, legend, size=8, color="#52606d", family="DejaVu Sans")
    figure.savefig(path, dpi=110)


def _rows(node: Behaviour) -> Iterator[tuple[Behaviour, int, int | None]]:
    """Each node with its depth and its parent's row, in the order of the tree."""
    stack: list[tuple[Behaviour, int, int | None]] = [(node, 0, None)]
    row = 0
    while stack:
        node, level, parent = stack.pop()
        yield node, level, parent
        stack.extend((child, level + 1, row) for child in reversed(node.children))
        row += 1
