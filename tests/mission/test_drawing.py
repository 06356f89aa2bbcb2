"""The tree as text and as a picture."""

from pathlib import Path

import cv2
import pytest
from py_trees.behaviours import Success
from py_trees.composites import Sequence

from mission import drawing
from trees.building import create_root


def test_the_text_names_every_node_of_the_mission() -> None:
    root = create_root()
    text = drawing.as_text(root)
    assert [node.name for node in root.iterate() if node.name not in text] == []


def test_rows_follow_the_tree_and_know_their_parents() -> None:
    root = Sequence("root", memory=True)
    branch = Sequence("branch", memory=True, children=[Success("leaf")])
    root.add_children([branch, Success("last")])
    rows = [(node.name, level, parent) for node, level, parent in drawing._rows(root)]
    assert rows == [("root", 0, None), ("branch", 1, 0), ("leaf", 2, 1), ("last", 1, 0)]


@pytest.mark.filterwarnings("error:Glyph")
def test_the_picture_has_a_row_for_each_node_and_every_symbol_its_glyph(tmp_path: Path) -> None:
    small, whole = tmp_path / "small.png", tmp_path / "whole.png"
    drawing.draw(Sequence("alone", memory=True), small)
    root = drawing.folded(create_root())
    drawing.draw(root, whole)
    heights = [cv2.imread(str(path)).shape[0] for path in (small, whole)]
    rows = len(list(root.iterate())) - 1
    assert heights[1] - heights[0] == pytest.approx(rows * 0.30 * 110, rel=0.02)


def test_the_drawing_can_be_searched_for_its_names(tmp_path: Path) -> None:
    path = tmp_path / "tree.svg"
    drawing.draw(drawing.folded(create_root()), path)
    assert "take the scan" in path.read_text()


def test_a_branch_that_stands_there_again_is_one_line() -> None:
    root = create_root()
    names = {node.name for node in root.iterate()}
    before = len(list(root.iterate()))
    after = list(drawing.folded(root).iterate())
    assert len(after) < before / 2
    assert names <= {node.name for node in after}
    assert any(isinstance(node, drawing.AsAbove) and node.name == "place, as above" for node in after)
