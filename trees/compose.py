"""Short words for the composites, so that the nesting of a factory reads like the tree it makes."""

from py_trees.behaviour import Behaviour
from py_trees.composites import Selector, Sequence
from py_trees.decorators import FailureIsSuccess, Repeat


def steps(name: str, *children: Behaviour) -> Sequence:
    """One after the other, each once, going on at the next tick where it was."""
    return Sequence(name, memory=True, children=list(children))


def first_that_works(name: str, *children: Behaviour) -> Selector:
    """The first child that succeeds; a child that failed is not asked again."""
    return Selector(name, memory=True, children=list(children))


def at_every_tick(name: str, *children: Behaviour) -> Sequence:
    """All in order, from the first one at every tick."""
    return Sequence(name, memory=False, children=list(children))


def most_important(name: str, *children: Behaviour) -> Selector:
    """The first that has something to do, looked at afresh at every tick; it interrupts the others."""
    return Selector(name, memory=False, children=list(children))


def until_failure(name: str, child: Behaviour) -> Behaviour:
    """Again and again; succeeds when the child fails, which is how it says that there is no more."""
    return FailureIsSuccess(name, Repeat(f"{name} (again)", child, num_success=-1))


def if_possible(name: str, child: Behaviour) -> Behaviour:
    """Worth trying; the mission goes on without it."""
    return FailureIsSuccess(name, child)
