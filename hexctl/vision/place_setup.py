"""What a camera cannot find out about a new place by looking: lens, print, height of the robot's tag."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hexctl.errors import InputError, argument
from hexctl.robot.model import Robot
from hexctl.vision.detection.floor import CornersPx, learn_floor
from hexctl.vision.detection.lens import Lens, load_lens
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.robot_tracker import RobotTag
from hexctl.vision.detection.tags import HOME_TAG
from hexctl.vision.place import Place, print_scale
from hexctl.vision.sheet import BAR_MM, Sheet

#: Field of view of a lens of which nothing is known: that of many webcams.
USUAL_FOV_DEG = 67.0

#: What is said where the length of the sheet's bar is not given: no picture shows it.
BAR_DOUBT = (
    "the bar of the sheet is taken for 100 mm long: measure it; --bar-mm with another length corrects this "
    "place at any time"
)

#: Lengths in mm, and angles in degrees, that differ by less are the same.
SAME = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceSetup:
    """What was given for a new place; None is what the place had before, or the usual.

    Attributes:
        lens: file of a calibration (`load_lens`); a lens without distortion unless given.
        fov_deg: from the left to the right edge, of a lens without distortion; `USUAL_FOV_DEG` unless given.
        bar_mm: length of the sheet's bar as printed; `BAR_MM` unless given.
        sheet: as it was printed: numbers and edges of the tags; or those of them that are given, by name.
        tag_height_mm: of the robot's tag above the origin of its base; the top of its trunk unless given.
    """

    lens: Path | None
    fov_deg: float | None
    bar_mm: float | None
    sheet: Sheet | Mapping[str, Any] | None
    tag_height_mm: float | None

    def check_known(self, place: Place, path: Path) -> None:
        """Raise InputError for what was given and is not so in a place that is known."""
        for name, given, known in (*self._numbers(place), *_sheet_numbers(self._printed, place)):
            if given is not None and (known is None or abs(given - known) > SAME):
                raise _contradiction(name, f"{given:g}", path, "none" if known is None else f"{known:g}")
        if self.lens is not None and _resolved(self.lens) != _resolved(place.lens_file):
            raise _contradiction("lens", str(self.lens), path, str(place.lens_file or "one that is assumed"))

    @property
    def _printed(self) -> Mapping[str, Any]:
        """What was given of the sheet, by the names of its attributes."""
        return asdict(self.sheet) if isinstance(self.sheet, Sheet) else self.sheet or {}

    def _numbers(self, place: Place) -> Iterator[tuple[str, float | None, float | None]]:
        """Arguments by name, as given and as the place has them; the bar may differ (`measured`)."""
        yield "fov_deg", self.fov_deg, place.fov_deg if place.lens_file is None else None
        yield "tag_height_mm", self.tag_height_mm, 1000 * place.robot_tag.height_m

    def measured(self, place: Place) -> tuple[Place, tuple[str, ...]]:
        """A known place by the length of the bar that was given, and what has changed by it, a sentence."""
        if self.bar_mm is None or self.bar_mm == place.bar_mm:
            return place, ()
        percent = 100 * (self.bar_mm / place.bar_mm - 1)
        return place.printed(self.bar_mm), (
            f"the bar of the sheet is {self.bar_mm:g} mm long, not {place.bar_mm:g}: "
            f"all distances change by {percent:+.1f} %",
        )

    def learned(
        self, views: Sequence[CornersPx], size_px: tuple[int, int], robot: Robot, before: Place | None
    ) -> tuple[Place, tuple[str, ...]]:
        """The place by what was seen of it, and what cannot be trusted of it, a sentence each.

        Args:
            views: corners (4, 2) in px by number, for each place of the camera (`learn_floor`).
            size_px: of the pictures.
            robot: whose tag it is.
            before: the place as it was, if it is learned again.

        Raises InputError for lenses and floors that are not allowed.
        """
        lens, lens_file = self._lens(size_px, before)
        bar_mm = self.bar_mm or (BAR_MM if before is None else before.bar_mm)
        scale = print_scale(bar_mm)
        robot_tag = self._robot_tag(robot, before, scale)
        edges_m = self._edges_m(before, robot_tag.tag_id)
        if robot_tag.tag_id in edges_m:
            raise InputError(
                f"{argument('robot_tag')}: got {robot_tag.tag_id}; allowed: no tag of the floor, "
                f"{', '.join(map(str, sorted(edges_m)))}"
            )
        floor = learn_floor(lens, views, {tag: scale * edge for tag, edge in edges_m.items()})
        place = Place(
            camera=floor.cameras[0],
            floor_tags=floor.tags,
            robot_tag=robot_tag,
            bar_mm=bar_mm,
            lens_file=lens_file,
            latency_s=None if before is None else before.latency_s,
        )
        unseen = _unseen_doubt(sorted(set(edges_m) - set(floor.tags)))
        return place, (*unseen, *floor.doubts, *(BAR_DOUBT,) * (self.bar_mm is None and before is None))

    def _lens(self, size_px: tuple[int, int], before: Place | None) -> tuple[Lens, Path | None]:
        """The lens, and its file if it has one."""
        if self.lens is not None:
            return load_lens(self.lens).scaled(*size_px), self.lens
        if self.fov_deg is None and before is not None:
            if before.lens_file is not None:
                return before.camera.lens.scaled(*size_px), before.lens_file
            return Lens.assumed(*size_px, before.fov_deg), None
        return Lens.assumed(*size_px, self.fov_deg or USUAL_FOV_DEG), None

    def _edges_m(self, before: Place | None, robot_tag: int) -> dict[int, float]:
        """Edges of the floor's tags as written on the sheet, by number; new ones are as those before."""
        sheet = Sheet(**self._printed)
        if before is None:
            return sheet.floor_edges_m
        scale = print_scale(before.bar_mm)
        known = {number: tag.edge_m / scale for number, tag in sorted(before.floor_tags.items())}
        others = (edge_m for number, edge_m in known.items() if number != HOME_TAG)
        usual_m = next(others, sheet.floor_edge_mm / 1000)
        numbers = sorted(sheet.floor_edges_m)
        if "floor_tags" not in self._printed:
            numbers = sorted({*numbers, *known} - {robot_tag})
        return {
            number: getattr(sheet, _edge_name(number)) / 1000
            if _edge_name(number) in self._printed
            else known.get(number, usual_m)
            for number in numbers
        }

    def _robot_tag(self, robot: Robot, before: Place | None, scale: float) -> RobotTag:
        known = None if before is None else before.robot_tag
        height_m = robot.body.size_m[2] / 2 if known is None else known.height_m
        if self.tag_height_mm is not None:
            height_m = self.tag_height_mm / 1000
        mount = PlanarPose(0.0, 0.0, 0.0) if known is None else known.mount
        sheet = Sheet(**self._printed)
        tag_id, edge_m = sheet.robot_tag, sheet.robot_edge_mm / 1000
        if known is not None and before is not None:
            tag_id = tag_id if "robot_tag" in self._printed else known.tag_id
            known_m = known.edge_m / print_scale(before.bar_mm)
            edge_m = edge_m if "robot_edge_mm" in self._printed else known_m
        return RobotTag(tag_id, edge_m * scale, mount, height_m)


def _edge_name(number: int) -> str:
    """Attribute of a sheet with the edge of a tag of the floor."""
    return "home_edge_mm" if number == HOME_TAG else "floor_edge_mm"


def _sheet_numbers(printed: Mapping[str, Any], place: Place) -> Iterator[tuple[str, float, float | None]]:
    """What is given of a sheet by name, and as a place has it; tags that it never saw are left out."""
    scale = print_scale(place.bar_mm)
    edges_m = Sheet(**printed).floor_edges_m
    known = [
        ("robot_tag", place.robot_tag.tag_id),
        ("robot_edge_mm", 1000 * place.robot_tag.edge_m / scale),
        *(
            (_edge_name(number), 1000 * tag.edge_m / scale)
            for number, tag in place.floor_tags.items()
            if number in edges_m
        ),
    ]
    yield from ((name, printed[name], value) for name, value in known if name in printed)


def _unseen_doubt(numbers: Sequence[int]) -> tuple[str, ...]:
    """What is said of printed tags that were not seen."""
    if not numbers:
        return ()
    those = f"tag {numbers[0]} is" if len(numbers) == 1 else f"tags {', '.join(map(str, numbers))} are"
    return (f"{those} not seen, and not used: in the picture, unfolded, and large enough?",)


def _contradiction(name: str, given: str, path: Path, known: str) -> InputError:
    return InputError(
        f"{argument(name)}: got {given}, and {path} has {known}; "
        f"allowed: what it has, {argument('relearn')}, or another {argument('place')}"
    )


def _resolved(path: Path | None) -> Path | None:
    return None if path is None else path.resolve()
