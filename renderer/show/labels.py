"""Labels on pictures that do not cover each other."""

from __future__ import annotations

import itertools

from .colors import RgbImage

_RINGS, _SIDES = 8, ((1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (1, 1), (-1, -1), (-1, 1))
_Box = tuple[int, int, int, int]


class Labels:
    """Writes labels into one picture, each where none of the others is."""

    def __init__(self, image: RgbImage) -> None:
        self.image = image
        self.taken: list[_Box] = []
        """(left, top, right, bottom) px of each label."""

    def write(self, text: str, at: tuple[int, int], color: tuple[int, ...] = (20, 20, 20)) -> None:
        """Write a text beside `at` (u, v) px, or near it with a line to it.

        A label that finds no free place within the picture is left out. What OpenCV's font does
        not have becomes `?`.
        """
        import cv2

        text = text.encode("ascii", "replace").decode()[:40]
        size = max(0.4, min(self.image.shape[:2]) / 900)
        (w, h), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
        place = self._free_place(at, w + 6, h + below + 5)
        if place is None:
            return
        (left, top, right, bottom), away = place
        self.taken.append((left, top, right, bottom))
        if away:
            cv2.line(self.image, at, ((left + right) // 2, (top + bottom) // 2), color, 1,
                     cv2.LINE_AA)
        cv2.rectangle(self.image, (left, top), (right - 1, bottom - 1), (255, 255, 255), -1)
        cv2.rectangle(self.image, (left, top), (right - 1, bottom - 1), color, 1)
        cv2.putText(self.image, text, (left + 3, bottom - below - 2), cv2.FONT_HERSHEY_SIMPLEX,
                    size, (20, 20, 20), 1, cv2.LINE_AA)

    def _free_place(self, at: tuple[int, int], w: int, h: int) -> tuple[_Box, bool] | None:
        """The box of a label and whether it is away from its point; None if there is no place."""
        height, width = self.image.shape[:2]
        u, v = (min(max(x, 0), n - 1) for x, n in zip(at, (width, height), strict=True))
        for ring, (x, y) in itertools.product(range(_RINGS), _SIDES):
            gap = 6 + ring * h
            left = u - w // 2 + x * (w // 2 + gap)
            top = v - h // 2 + y * (h // 2 + gap)
            box = (left, top, left + w, top + h)
            inside = left >= 0 and top >= 0 and box[2] <= width and box[3] <= height
            if inside and not any(overlap(box, other) for other in self.taken):
                return box, ring > 0
        return None


def overlap(a: _Box, b: _Box) -> bool:
    """Return whether two boxes (left, top, right, bottom) share a pixel."""
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
