"""Where a ball touches in each picture of a coloured gel, without marks by hand: circle, its uncertainty, or why not.

Every press is found by itself (contact_circle.py). Together they then tell the gel's response to slope: light -> normal
q by one linear map M for all presses (of order 1 over the picture), least squares inside the circles. A press that the
map of all others does not explain as this ball shows something else. And M is a second opinion on each centre, the
median of p - R q over the circle: the first follows the crease at the contact's edge, the second where the light is
that of a flat pad. The centre is the mean of both; half of what they are apart is part of its uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from ruffini.estimators.photometric.change import Change
from ruffini.estimators.photometric.circle import KINKED, SMOOTH, Circle, Contact, fit_circle, odd_centre, odd_radius

Array = npt.NDArray[np.float64]

LEAST_CHANGE = 0.02  # of light where it changed most: less is no press
NOISES = 8.0  # of the smoothed picture that a press exceeds
MOST_MISFIT = 0.35  # of the light round a contact that no ball explains; recorded presses at most 0.05
SMOOTH_MISFIT = 0.93  # of the kinked fit's, median of all presses; recorded gel 0.96, drawn smooth ones 0.2 to 0.91
LEAST_INSIDE = 0.5  # of a circle that lies in the picture
FITTED_INSIDE = 0.9  # of a circle: what the map is fitted on
BALL_LIMIT = 0.95  # of the ball's radius: beyond it the surface is too steep to say anything
LEAST_EXPLAINED = 0.5  # of the squared normals of a ball, by the map of the other presses; recorded: 0.87 and more
ENOUGH_OTHERS = 5  # presses, from which on each is judged by the others
ROUNDS = 5
SECOND_CONTACT = 0.4  # of the first one's change of light, from which on another contact counts
SECOND_EXPLAINED = 0.7  # of its normals: another ball, not a fold or a blot


@dataclass(frozen=True)
class NotFound:
    """Why a picture is no press of this ball."""

    reason: str


def find_balls(changes: list[Change], ball_radius_px: float) -> list[Circle | NotFound]:
    """The contact circle of each press of one ball on one unit, in the pixels of the pictures given."""
    if not changes:
        return []
    ball_px = ball_radius_px / changes[0].px
    first, leaving = _contacts(changes, ball_px)
    alone = {i: found.circle for i, found in enumerate(first) if isinstance(found, Contact)}
    opinions = _joint({i: changes[i] for i in alone}, alone, ball_px)
    out: list[Circle | NotFound] = []
    for i, found in enumerate(first):
        if isinstance(found, NotFound):
            out.append(found)
            continue
        second, explained = opinions.of[i]
        if explained < LEAST_EXPLAINED:
            out.append(NotFound("its colours do not fit a ball of this size as those of the other presses do"))
            continue
        if _has_second(changes[i], found, ball_px, opinions.unmix, leaving):
            out.append(NotFound("there are two contacts: press with one ball at a time"))
            continue
        out.append(_in_picture(_mean(found.circle, second), changes[i].px))
    return out


def _contacts(changes: list[Change], ball_px: float) -> tuple[list[Contact | NotFound], int]:
    """The contact of each picture by itself, and how the gel leaves the ball: one gel, so one answer for all presses.

    With the smooth shape radii of a gel that has a kink come out too small; it has to be clearly better.
    """
    kinked = [_contact(change, ball_px, KINKED) for change in changes]
    smooth = [_contact(change, ball_px, SMOOTH) for change in changes]
    ratios = [b.misfit / max(a.misfit, 1e-9) for a, b in zip(kinked, smooth, strict=True)
              if isinstance(a, Contact) and isinstance(b, Contact)]  # fmt: skip
    is_smooth = len(ratios) > 0 and float(np.median(ratios)) < SMOOTH_MISFIT
    return (smooth, SMOOTH) if is_smooth else (kinked, KINKED)


def _contact(change: Change, ball_px: float, leaving: int) -> Contact | NotFound:
    """The contact of one picture by itself."""
    size = np.linalg.norm(cv2.GaussianBlur(change.light, (0, 0), 3), axis=2)
    top = float(np.quantile(size, 0.995))
    if top < max(LEAST_CHANGE, NOISES * float(np.linalg.norm(change.noise)) / 2):
        return NotFound(f"no more than {100 * top:.1f} % of the light changed against the reference")
    x, y, _ = odd_centre(change.light, ball_px)
    radius, _ = odd_radius(change.light, x, y)
    found = fit_circle(change, x, y, radius, leaving)
    if found.misfit > MOST_MISFIT:
        return NotFound(f"nothing round: {100 * found.misfit:.0f} % of what changed is not as a ball changes it")
    if found.is_at_bound:
        return NotFound(f"the contact's edge was not found up to {found.circle.radius_px * change.px:.0f} px")
    inside = _share_inside(found.circle, change.light.shape)
    if inside < LEAST_INSIDE:
        return NotFound(f"only {100 * inside:.0f} % of the contact is in the picture")
    return found


def _share_inside(circle: Circle, shape: tuple[int, ...]) -> float:
    n = np.arange(shape[0]), np.arange(shape[1])
    dx, dy = n[1][None, :] - circle.center_x_px, n[0][:, None] - circle.center_y_px
    return float((np.hypot(dx, dy) < circle.radius_px).sum() / (np.pi * circle.radius_px**2))


def _has_second(change: Change, found: Contact, ball_px: float, unmix: Array, leaving: int) -> bool:
    """Whether what is left without the contact found holds another one of this ball."""
    circle = found.circle
    rows, columns = np.indices(change.light.shape[:2])
    away = np.hypot(columns - circle.center_x_px, rows - circle.center_y_px) / circle.radius_px
    light = change.light * np.clip(2 * away - 3.2, 0, 1)[..., None]  # from 1.6 to 2.1 radii
    x, y, _ = odd_centre(light, min(ball_px, circle.radius_px))
    radius, size = odd_radius(light, x, y)
    _, size_of_first = odd_radius(change.light, circle.center_x_px, circle.center_y_px)
    apart = np.hypot(x - circle.center_x_px, y - circle.center_y_px)
    if size < SECOND_CONTACT * size_of_first or apart < 1.6 * circle.radius_px or radius > 1.6 * circle.radius_px:
        return False
    rest = replace(change, light=light)
    second = fit_circle(rest, x, y, radius, leaving)
    at = (second.circle.center_x_px, second.circle.center_y_px)
    order = len(unmix) // 6
    return (
        second.misfit < MOST_MISFIT and _improved(rest, second.circle, at, unmix, ball_px, order)[1] > SECOND_EXPLAINED
    )


def _mean(first: Circle, second: tuple[float, float]) -> Circle:
    x, y = (first.center_x_px + second[0]) / 2, (first.center_y_px + second[1]) / 2
    apart = np.hypot(first.center_x_px - second[0], first.center_y_px - second[1]) / 2
    return Circle(x, y, first.radius_px, float(np.hypot(first.center_sigma_px, apart)), first.radius_sigma_px)


def _in_picture(circle: Circle, px: float) -> Circle:
    """From the pixels worked on to those of the picture."""
    return Circle((circle.center_x_px + 0.5) * px - 0.5, (circle.center_y_px + 0.5) * px - 0.5, circle.radius_px * px,
                  circle.center_sigma_px * px, circle.radius_sigma_px * px)  # fmt: skip


@dataclass(frozen=True)
class _Opinions:
    """Of each press its centre by the response of all and the share of its ball's normals that the others' explains.

    `unmix` (3 n_terms, 2): the response of all.
    """

    of: dict[int, tuple[tuple[float, float], float]]
    unmix: Array


def _joint(changes: dict[int, Change], circles: dict[int, Circle], ball_px: float) -> _Opinions:
    """What the presses say of each other."""
    unmix: Array = np.zeros((3, 2))
    place = {i: (c.center_x_px, c.center_y_px) for i, c in circles.items()}
    weight = dict.fromkeys(circles, 1.0)
    explained = dict.fromkeys(circles, 0.0)
    if not circles:
        return _Opinions({}, unmix)
    for turn in range(ROUNDS):
        order = min(turn, 1) if len(circles) > 2 else 0
        sums = {i: _equations(changes[i], replace(circles[i], center_x_px=x, center_y_px=y), ball_px, order)
                for i, (x, y) in place.items()}  # fmt: skip
        gram = sum((weight[i] * s[0] for i, s in sums.items()), np.zeros(()))
        right = sum((weight[i] * s[1] for i, s in sums.items()), np.zeros(()))
        unmix = _solved(gram, right)
        for i, (own_gram, own_right) in sums.items():
            own = weight[i] if len(circles) > ENOUGH_OTHERS else 0.0
            others = _solved(gram - own * own_gram, right - own * own_right)
            place[i], explained[i] = _improved(changes[i], circles[i], place[i], others, ball_px, order)
        weight = {i: float(np.clip(2 * explained[i] - 0.5, 0.0, 1.0)) for i in circles}
        if not any(weight.values()):
            weight = dict.fromkeys(circles, 1.0)
    return _Opinions({i: (place[i], explained[i]) for i in circles}, unmix)


def _solved(gram: Array, right: Array) -> Array:
    ridge = 1e-5 * max(float(np.trace(gram)), 1e-12) / len(gram) * np.eye(len(gram))
    return np.asarray(np.linalg.solve(gram + ridge, right), dtype=np.float64)


def _equations(change: Change, circle: Circle, ball_px: float, order: int) -> tuple[Array, Array]:
    """Normal equations of q = M d inside a circle, per pixel."""
    offset, features = _inside(change, circle, ball_px, order)
    n = max(len(offset), 1)
    return features.T @ features / n, features.T @ (offset / ball_px) / n


def _improved(
    change: Change, circle: Circle, place: tuple[float, float], unmix: Array, ball_px: float, order: int
) -> tuple[tuple[float, float], float]:
    """The centre by this map, and the share of the ball's normals round the first one that it explains."""
    at = place
    for _ in range(3):
        offset, features = _inside(change, replace(circle, center_x_px=at[0], center_y_px=at[1]), ball_px, order)
        if len(offset) < 30:
            return place, 0.0
        x, y = np.median(offset - ball_px * features @ unmix, axis=0)
        limit = circle.radius_px / max(float(np.hypot(x, y)), circle.radius_px)
        at = (at[0] + limit * float(x), at[1] + limit * float(y))
    offset, features = _inside(change, replace(circle, center_x_px=at[0], center_y_px=at[1]), ball_px, order)
    if len(offset) < 30 or np.hypot(at[0] - circle.center_x_px, at[1] - circle.center_y_px) > 0.5 * circle.radius_px:
        return place, 0.0
    truth = offset / ball_px
    return at, 1 - float(((features @ unmix - truth) ** 2).sum() / (truth**2).sum())


def _inside(change: Change, circle: Circle, ball_px: float, order: int) -> tuple[Array, Array]:
    """Offset (n, 2) from the centre of the usable pixels in a circle; light there times 1, x, y: (n, 3 n_terms)."""
    height, width = change.light.shape[:2]
    rows, columns = np.indices((height, width))
    dx, dy = columns - circle.center_x_px, rows - circle.center_y_px
    limit = FITTED_INSIDE * min(circle.radius_px, BALL_LIMIT * ball_px)
    mask = (np.hypot(dx, dy) < limit) & change.is_usable
    terms = np.stack([np.ones(mask.sum()), 2 * columns[mask] / width - 1, 2 * rows[mask] / height - 1], axis=1)
    features = terms[:, : 1 + 2 * order, None] * change.light[mask][:, None, :]
    return np.stack([dx[mask], dy[mask]], axis=1), features.reshape(len(terms), 3 + 6 * order)
