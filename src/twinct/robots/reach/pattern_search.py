"""Pattern search: steps along single directions, which become smaller when none of them helps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from twinct.geometry import Floats


def climbed(
    start: Floats,
    sizes: Sequence[float],
    steps: Sequence[Floats],
    ranges: Floats,
    score: Callable[[Floats], float],
    step: Callable[[], None],
    most: float,
    over: Callable[[], bool],
) -> Floats:
    """Return the best point of a pattern search with all step sizes from a start within ranges.

    Args:
        start: first point, (k,).
        sizes: step sizes, one after the other.
        steps: directions of steps, (k,).
        ranges: lowest and highest value of each coordinate, (k, 2).
        score: score of a point; the largest is sought.
        step: called after each size.
        most: score at which the search ends, because there is none better.
        over: returns True once the time of the search is over.
    """
    best, (low, high) = start, ranges.T
    for size in sizes:
        moved = not over() and score(best) < most
        while moved:
            moved = False
            for direction in steps:
                for sign in (1, -1):
                    if over():
                        return best
                    trial = best + sign * size * direction
                    inside = (low <= trial) & (trial <= high)
                    if inside[direction != 0].all() and score(trial) > score(best):
                        best, moved = trial, True
                        break
        step()
    return best
