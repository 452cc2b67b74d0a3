"""The heap on a side-view photograph: which pixels are its.

What touches the picture's margin is background: the wall, the table, a hand that reaches in. Its colours are
learnt there, all that differs from them is a candidate, and the candidate that is shaped like a heap is cut
out by GrabCut (Rother et al., 2004), which learns the colours of both sides and puts the border where the
picture has an edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calstudy.errors import MeasurementError
from calstudy.parameters import Array

Mask = NDArray[np.bool_]
Colours = NDArray[np.uint8]

FINDING_SIDE = 700
"""Longer side in pixels at which the heap is looked for."""
MARGIN = 0.03
"""Share of a side of the picture that is taken for background."""
CLUSTERS = 8
"""Colours that the background is described by."""
LEAST_SHARE, LEAST_HEIGHT = 0.004, 18
"""Of a heap: area as a share of the picture's, height in pixels where it is looked for."""
LEAST_DIFFERENCE = 3.0
"""Least difference of colour from the background, in units of CIELAB."""
LEVELS, OPENINGS = (0.35, 0.6, 1.0, 1.4), (0.0, 0.02, 0.04)
"""Looks at one picture: factors of the level, and how wide a bridge to another object is cut."""
LEAST_CONVEXITY, NEARLY = 0.85, 0.7
"""Least share of its hull that a heap fills; area, over the largest, of what is compared by it."""
SURROUNDINGS, STRIP = 0.3, (0.02, 0.08)
"""Shares of the heap's width: what is seen around it; how far inside and outside of the seed the edge may
be."""
GRABCUT_ROUNDS = 3
EDGE, LONG, LOWER = 0.4, 0.02, 0.5
"""The outline is moved to an edge of the picture in the lower part of the heap, a share of its height: where
the colour differs from that beside the heap by this share of what is usual in the heap, if that is farther
from the outline than this share of the heap's width."""


@dataclass(frozen=True, slots=True)
class Cut:
    """A heap cut out of a photograph."""

    picture: Colours
    """Its part of the photograph (rows, columns, 3), at the size of the segmentation."""
    heap: Mask
    """True for the heap's pixels (rows, columns)."""
    corner: tuple[int, int]
    """Column and row of the photograph at which the part begins."""
    scale: float
    """Pixels of the photograph for one of the part."""


def cut_out(
    photograph: Colours,
    differs: Array,
    longer_side: int,
    sensitivity: float = 1.0,
    like: Callable[[Mask], bool] | None = None,
) -> Cut:
    """The heap of a photograph (rows, columns, 3), blue first.

    It is found on the whole picture by how that ``differs`` from its background (`difference`), and cut out
    of its part, which is made ``longer_side`` pixels long if it is longer. ``sensitivity`` scales how
    different a candidate must be; ``like`` says which candidates look like a heap, without it those that do
    from the side. MeasurementError where none does.
    """
    level = sensitivity * max(_otsu(differs), LEAST_DIFFERENCE)
    looks = [
        _objects(_opened(differs > factor * level, opening)) for factor in LEVELS for opening in OPENINGS
    ]
    seed, others = _heap(looks, like or is_heap_from_the_side)
    return _refined(photograph, seed, others, longer_side)


def sized(photograph: Colours, longer_side: int) -> Colours:
    """The photograph with a longer side of so many pixels; a smaller one as it is."""
    factor = longer_side / max(photograph.shape[:2])
    if factor >= 1:
        return photograph
    size = [max(1, round(factor * n)) for n in photograph.shape[1::-1]]
    return np.asarray(cv2.resize(photograph, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _lab(photograph: Colours) -> Array:
    smooth = cv2.bilateralFilter(photograph, 7, 30, 5)
    return np.asarray(cv2.cvtColor(smooth.astype(np.float32) / 255, cv2.COLOR_BGR2LAB), dtype=float)


def blurred_lab(picture: Colours, deviation: float) -> Array:
    """CIELAB (rows, columns, 3) of a picture blurred by so many pixels."""
    soft = cv2.GaussianBlur(picture, (0, 0), deviation).astype(np.float32) / 255
    return np.asarray(cv2.cvtColor(soft, cv2.COLOR_BGR2LAB))


def colour_distance(one: Array, other: Array) -> Array:
    """Distance of colours (..., 3) in CIELAB."""
    return np.asarray(np.sqrt(((one - other) ** 2).sum(axis=-1)), dtype=float)


def _margin(shape: tuple[int, ...]) -> Mask:
    wide = max(2, round(MARGIN * max(shape[:2])))
    margin = np.ones(shape[:2], bool)
    margin[wide:-wide, wide:-wide] = False
    return margin


def difference(photograph: Colours) -> Array:
    """Distance (rows, columns) in CIELAB of each pixel from the nearest colour of the margin.

    It is that of the photograph at ``FINDING_SIDE``.
    """
    cv2.setRNGSeed(1)
    lab = _lab(sized(photograph, FINDING_SIDE))
    background = lab[_margin(lab.shape)].astype(np.float32)
    rule = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.5)
    none = np.empty(0, np.int32)
    _, which, centres = cv2.kmeans(background, CLUSTERS, none, rule, 2, cv2.KMEANS_PP_CENTERS)
    nearest = np.full(lab.shape[:2], np.inf)
    for k, centre in enumerate(centres):
        own = background[which[:, 0] == k] - centre
        spread = max(1.0, float(np.sqrt((own**2).sum(axis=1).mean())))
        nearest = np.minimum(nearest, colour_distance(lab, centre) / math.sqrt(spread))
    return nearest


def _otsu(values: Array) -> float:
    """The threshold that parts values into two groups best (Otsu, 1979)."""
    top = float(np.quantile(values, 0.999))
    scaled = (255 * np.clip(values / max(top, 1e-9), 0, 1)).astype(np.uint8)
    threshold, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return threshold / 255 * top


def _opened(mask: Mask, opening: float) -> Mask:
    """A mask without specks and holes, and without what is thinner than a share of the picture's width."""
    wide = 2 * round(0.5 * opening * max(mask.shape)) + 1
    small, large, thin = (cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (n, n)) for n in (3, 9, wide))
    clean = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, small)
    whole = filled(cv2.morphologyEx(clean, cv2.MORPH_CLOSE, large) > 0)
    return np.asarray(cv2.morphologyEx(whole.astype(np.uint8), cv2.MORPH_OPEN, thin) > 0)


def filled(mask: Mask) -> Mask:
    """A mask without holes."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    solid = np.zeros(mask.shape, np.uint8)
    cv2.drawContours(solid, contours, -1, 1, cv2.FILLED)
    return solid > 0


def _objects(mask: Mask) -> list[Mask]:
    """Objects that do not touch the border, largest first."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    rows, columns = mask.shape
    found = []
    for k in 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA]):
        left, top, width, height, area = stats[k]
        if area < LEAST_SHARE / 4 * mask.size:
            break
        if left > 0 and top > 0 and left + width < columns and top + height < rows:
            found.append(labels == k)
    return found


def _heap(looks: list[list[Mask]], like: Callable[[Mask], bool]) -> tuple[Mask, Mask]:
    """The object that is most like a heap, and what else its look shows; MeasurementError without one.

    A heap bulges outwards: of those that are nearly as large as the largest, it is the one that fills its
    convex hull best.
    """
    found = [(thing, _convexity(thing), k) for k, objects in enumerate(looks) for thing in objects]
    found = [one for one in found if one[1] > LEAST_CONVEXITY and like(one[0])]
    if not found:
        raise MeasurementError(
            "no object looks like a heap: all of it must be free of the picture's border and of other "
            "things, before a plain background; choose its part of the picture with --region"
        )
    largest = max(np.count_nonzero(thing) for thing, _, _ in found)
    near = [one for one in found if np.count_nonzero(one[0]) > NEARLY * largest]
    thing, _, look = max(near, key=lambda one: one[1])
    others = np.zeros(thing.shape, bool)
    for other in looks[look]:
        others |= other & ~thing
    return thing, others


def is_heap_from_the_side(thing: Mask) -> bool:
    """Whether an object is wider than high and narrower at its top."""
    rows, columns = np.flatnonzero(thing.any(axis=1)), np.flatnonzero(thing.any(axis=0))
    height, width = int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1
    if np.count_nonzero(thing) < LEAST_SHARE * thing.size or height < LEAST_HEIGHT:
        return False
    across = thing[rows[0] : rows[-1] + 1].sum(axis=1)
    quarter = max(1, height // 4)
    return bool(width > 1.2 * height and across[:quarter].mean() < 0.7 * across[-2 * quarter :].max())


def is_heap_from_above(thing: Mask) -> bool:
    """Whether an object is about as wide as deep."""
    rows, columns = np.flatnonzero(thing.any(axis=1)), np.flatnonzero(thing.any(axis=0))
    sides = int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1
    return bool(np.count_nonzero(thing) > LEAST_SHARE * thing.size and max(sides) < 1.5 * min(sides))


def _convexity(thing: Mask) -> float:
    """Share of its convex hull that an object fills."""
    hull = cv2.convexHull(cv2.findNonZero(thing.astype(np.uint8)))
    return np.count_nonzero(thing) / max(1.0, cv2.contourArea(hull))


def _refined(photograph: Colours, seed: Mask, others: Mask, longer_side: int) -> Cut:
    """The heap cut out by GrabCut within its surroundings, from where it was found on a smaller picture."""
    rows, columns = np.flatnonzero(seed.any(axis=1)), np.flatnonzero(seed.any(axis=0))
    shrunk = photograph.shape[1] / seed.shape[1]
    reach = SURROUNDINGS * (columns[-1] - columns[0])
    left, top = (max(0, int(shrunk * (first - reach))) for first in (columns[0], rows[0]))
    right, bottom = (int(shrunk * (last + 1 + reach)) for last in (columns[-1], rows[-1]))
    part = photograph[top:bottom, left:right]
    picture = np.ascontiguousarray(sized(part, longer_side))
    scale = part.shape[1] / picture.shape[1]
    marks = _marks(*(_window(mask, part, picture, (left, top), shrunk) for mask in (seed, others)))
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.setRNGSeed(1)
    cv2.grabCut(picture, marks, (0, 0, 0, 0), *models, GRABCUT_ROUNDS, cv2.GC_INIT_WITH_MASK)
    cut = (marks == cv2.GC_FGD) | (marks == cv2.GC_PR_FGD)
    largest = _largest(cut)
    if np.concatenate([largest[0], largest[-1], largest[:, 0], largest[:, -1]]).any():
        raise MeasurementError("the heap runs into the picture's border or into another thing; keep it free")
    return Cut(picture, _largest(_up_to_its_edges(picture, filled(largest))), (left, top), scale)


def _up_to_its_edges(picture: Colours, heap: Mask) -> Mask:
    """The heap without what has the colour of the background beside it: a disc that it stands on.

    GrabCut's border may end where no edge is: as far from the seed as the strip allows.
    """
    lab = blurred_lab(picture, 1.5)
    rows, wide = np.flatnonzero(heap.any(axis=1)), np.count_nonzero(heap.any(axis=0))
    low = rows >= rows[0] + (1 - LOWER) * len(rows)
    step, columns = max(4, round(0.015 * wide)), np.arange(heap.shape[1])
    kept = heap.copy()
    for way in (1, -1):  # from the left, from the right
        colours, inside = lab[rows, ::way], heap[rows, ::way]
        first = inside.argmax(axis=1)
        strip = np.maximum(first[:, None] - step - np.arange(step), 0)
        beside = np.take_along_axis(colours, strip[..., None], axis=1).mean(axis=1, keepdims=True)
        differs = colour_distance(colours, beside)
        is_edge = inside & (differs > EDGE * np.median(differs[inside]))
        edge = np.where(is_edge.any(axis=1), is_edge.argmax(axis=1), len(columns))
        moved = low & (edge - first > LONG * wide)
        kept[rows, ::way] &= ~(moved[:, None] & (columns < edge[:, None]))
    return kept


def _largest(mask: Mask) -> Mask:
    """The largest object of a mask without specks; MeasurementError where there is none."""
    small = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    clean = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, small)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(clean, connectivity=4)
    if len(stats) < 2:
        raise MeasurementError("the heap does not stand out from its background; put a plain sheet behind it")
    return np.asarray(labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA]))


def _window(
    mask: Mask, part: Colours, picture: Colours, corner: tuple[int, int], shrunk: float
) -> NDArray[np.uint8]:
    """A mask of the small picture as one of the part (rows, columns), 0 or 1."""
    (left, top), (rows, columns) = corner, part.shape[:2]
    whole = mask.astype(np.float32)
    turn = np.array([[picture.shape[1] / columns, 0.0, 0.0], [0.0, picture.shape[0] / rows, 0.0]])
    turn = turn @ np.array([[shrunk, 0, -left], [0, shrunk, -top], [0, 0, 1.0]])
    near = cv2.warpAffine(whole, turn, picture.shape[1::-1], flags=cv2.INTER_LINEAR)
    return np.asarray(near > 0.5, dtype=np.uint8)


def _marks(seed: NDArray[np.uint8], others: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """What GrabCut starts from: sure inside, sure outside, and a strip on both sides of the seed's edge."""
    columns = np.flatnonzero(seed.any(axis=0))
    inner, outer = (
        cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1))
        for n in (max(3, round(share * len(columns))) for share in STRIP)
    )
    marks = np.full(seed.shape, cv2.GC_BGD, np.uint8)
    marks[cv2.dilate(seed, outer) > 0] = cv2.GC_PR_BGD
    marks[seed > 0] = cv2.GC_PR_FGD
    marks[cv2.erode(seed, inner) > 0] = cv2.GC_FGD
    marks[(others > 0) & (marks != cv2.GC_FGD)] = cv2.GC_BGD
    return marks
