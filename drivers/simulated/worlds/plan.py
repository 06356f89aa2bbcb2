"""A building as its user writes it down in YAML: rooms as polygons, doors and windows in their walls, furniture."""

from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.refusal import told
from perception.failure import FailureError

Point = tuple[float, float]
Kind = Literal[
    "desk", "table", "chair", "shelf", "cabinet", "cupboard", "box", "lamp", "beam", "column",
    "curtain", "board", "radiator", "bar",
]  # fmt: skip
Positive = Annotated[float, Field(gt=0)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RoomPlan(_Part):
    """A room: its floor outline between the wall faces, as ``polygon`` or as ``box: [x0, y0, x1, y1]``.

    ``seeded`` says how many pieces of each kind are to be drawn at random; ``height`` overrides the building's.
    """

    polygon: tuple[Point, ...] = ()
    box: tuple[float, float, float, float] | None = None
    height: Positive | None = None
    seeded: dict[Kind, Annotated[int, Field(ge=0)]] = {}

    @model_validator(mode="after")
    def _has_an_outline(self) -> "RoomPlan":
        if (self.box is None) == (len(self.polygon) < 3):
            raise ValueError("give either a polygon of at least three corners or a box")
        return self

    @property
    def outline(self) -> tuple[Point, ...]:
        """Corners of the floor."""
        if self.box is None:
            return self.polygon
        x0, y0, x1, y1 = self.box
        return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


class DoorPlan(_Part):
    """A door in the wall of ``room`` nearest to ``at``; its leaf opens into that room.

    ``angle`` is how far the leaf stands open in degrees (0 is shut), ``hinge`` its side as seen from inside the
    room, ``leaf`` its width (the whole door by default, 0 for a doorway without one).
    """

    room: str
    at: Point
    width: Positive = 0.9
    height: Positive = 2.1
    angle: Annotated[float, Field(ge=0, le=175)] = 95.0
    hinge: Literal["left", "right"] = "left"
    leaf: Annotated[float, Field(ge=0)] | None = None


class WindowPlan(_Part):
    """A pane of glass in the wall of ``room`` nearest to ``at``."""

    room: str
    at: Point
    width: Positive = 1.4
    sill: Annotated[float, Field(ge=0)] = 0.9
    height: Positive = 1.4


class NichePlan(_Part):
    """A recess of ``depth`` in the wall of ``room`` nearest to ``at``; as tall as a door by default."""

    room: str
    at: Point
    width: Positive = 0.9
    sill: Annotated[float, Field(ge=0)] = 0.0
    height: Positive = 2.0
    depth: Positive = 0.1


class MirrorPlan(_Part):
    """A mirror on the wall of ``room`` nearest to ``at``."""

    room: str
    at: Point
    width: Positive = 0.8
    sill: Annotated[float, Field(ge=0)] = 0.4
    height: Positive = 1.5


class PiecePlan(_Part):
    """A piece of furniture placed by hand; ``at`` is the centre of its footprint, ``yaw`` in degrees."""

    kind: Kind
    at: Point
    yaw: float = 0.0
    size: tuple[Positive, Positive, Positive] | None = None


class OutsidePlan(_Part):
    """Something to be seen through the windows: a ``facade`` (box) or a ``tree``."""

    kind: Literal["facade", "tree"]
    at: Point
    yaw: float = 0.0
    size: tuple[Positive, Positive, Positive] = (10.0, 2.0, 6.0)


class StartPlan(_Part):
    """Where the base stands at first; ``yaw`` in degrees."""

    at: Point
    yaw: float = 0.0


class Plan(_Part):
    """A whole building on one storey, metres and degrees, floor at z = 0."""

    name: str
    height: Positive = 3.0
    outer_wall: Positive = 0.3
    rooms: dict[str, RoomPlan]
    start: StartPlan | None = None
    doors: tuple[DoorPlan, ...] = ()
    windows: tuple[WindowPlan, ...] = ()
    niches: tuple[NichePlan, ...] = ()
    mirrors: tuple[MirrorPlan, ...] = ()
    furniture: tuple[PiecePlan, ...] = ()
    outside: tuple[OutsidePlan, ...] = ()

    @model_validator(mode="after")
    def _names_exist(self) -> "Plan":
        if not self.rooms:
            raise ValueError("a plan needs at least one room")
        for group in ("doors", "windows", "niches", "mirrors"):
            for index, part in enumerate(getattr(self, group)):
                if part.room not in self.rooms:
                    raise ValueError(f"{group}.{index}.room: there is no room '{part.room}'")
        return self


def read_plan(path: Path) -> Plan:
    """Read a plan; raises ``WORLD_PLAN_INVALID`` with every error and its dotted key."""
    try:
        return Plan.model_validate(yaml.safe_load(path.read_text()))
    except OSError as error:
        raise FailureError("WORLD_UNREADABLE", f"cannot read {path}: {error}", path=str(path)) from error
    except yaml.YAMLError as error:
        raise FailureError("WORLD_PLAN_INVALID", f"{path.name} is not YAML: {error}", path=str(path)) from error
    except ValidationError as error:
        errors = [told(item) for item in error.errors()]
        raise FailureError("WORLD_PLAN_INVALID", f"{path.name}: " + "; ".join(errors), errors=errors) from error
