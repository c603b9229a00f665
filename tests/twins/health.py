"""Whether a filter still foretells as well as who repeats, or extends, the last measurements."""

import math

import numpy as np

from tests.twins.gaussian import at

MEMORY = 0.95  # of the exponential mean, per received sample
BEHIND = math.log(25.0)


def naive_errors(past, t, value, angle):
    """Errors at time t of repeating the last of some (time, value) pairs, and of extending two."""
    (s, before), (last, after) = past[-2:]
    moved = difference(value, after, angle)
    slope = difference(after, before, angle) / (last - s)
    return moved, difference(moved, slope * (t - last), angle)


def difference(a, b, angle):
    """a − b, by the shorter way round if it is one of angles."""
    return math.remainder(a - b, 2 * math.pi) if angle else a - b


def behind(model, time, y, innovations):
    """After each sample, the mean of ln((1 + own) / (1 + naive)) over the received ones.

    Own and naive are mean squares, in units of the model's R, over the received components that
    have been received twice before: of the innovation, and of the better of the two naive guesses.
    """
    mean, course = 0.0, []
    past = [[] for _ in range(model.m)]
    for k, t in enumerate(time):
        got = np.flatnonzero(~np.isnan(innovations[k]))
        judged = [i for i in got if len(past[i]) >= 2]
        if judged:
            variances = np.diag(at(model.R, k))[judged]
            own = (innovations[k, judged] ** 2 / variances).mean()
            errors = [naive_errors(past[i], t, y[k, i], i in model.angles) for i in judged]
            naive = (np.square(errors) / variances[:, None]).mean(axis=0).min()
            mean = MEMORY * mean + (1 - MEMORY) * math.log((1 + own) / (1 + naive))
        for i in got:
            past[i].append((t, y[k, i]))
        course.append(mean)
    return np.array(course)
