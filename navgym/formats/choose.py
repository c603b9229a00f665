"""Which channel counts where a log has several that could."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from navgym.core.checks import one_of
from navgym.formats.channels import ESTIMATE, SENSOR, Channel, Channels

NONE = "none"  # in place of a channel's name: that role is left out


def chosen(
    channels: Channels,
    role: str,
    kinds: Sequence[str],
    topics: Mapping[str, str],
    said: list[str],
    estimates: bool = True,
) -> Channel | None:
    """The channel of a role: as told, else the only one of the best rank; None where there is none.

    Args:
        channels: of the log.
        role: what it is wanted for, a key of `topics`.
        kinds: what it may hold.
        topics: names of channels by role, as the user says.
        said: gets a sentence about what was left out.
        estimates: whether one that a filter made of other sensors will do.

    Raises ValueError for a name that is not there, and where several could be meant.
    """
    there = channels.of(*kinds)
    told = topics.get(role)
    if told == NONE:
        return None
    if told is not None:
        name = one_of(f"topics.{role} of {channels.path.name}:", told, [c.name for c in there])
        return next(c for c in there if c.name == name)
    usable = [c for c in there if estimates or c.rank != ESTIMATE]
    if not usable:
        if there:
            remedy = f"topics={{{role!r}: {there[0].name!r}}} takes one"
            said.append(f"{_names(there)} left out as {role}: estimates, not a sensor's; {remedy}")
        return None
    best = min(c.rank for c in usable)
    first = [c for c in usable if c.rank == best]
    if best not in (SENSOR, ESTIMATE):
        first = first[:1]
    if len(first) > 1:
        raise ValueError(
            f"{channels.path.name}: {' and '.join(c.name for c in first)} could each be the {role}: "
            f"say which counts with topics={{{role!r}: {first[0].name!r}}}."
        )
    rest = [c for c in there if c is not first[0]]
    if rest:
        said.append(f"{first[0].name} is the {role}; left out: {_names(rest)}")
    return first[0]


def check_roles(topics: object, roles: Sequence[str]) -> dict[str, str]:
    """`topics` as a dict; ValueError for a role that is none of `roles`, or a value that is no text."""
    if topics is not None and not isinstance(topics, Mapping):
        example = f"{{{roles[0]!r}: '/name'}}"
        raise ValueError(f"topics must be a dict such as {example}, got {topics!r}.")
    told: Mapping[str, str] = {} if topics is None else topics
    for role, name in told.items():
        one_of("role in topics:", role, roles)
        if not isinstance(name, str):
            raise ValueError(f"topics.{role} must be the name of a topic, got {name!r}.")  # noqa: TRY004 - as every wrong option
    return dict(told)


def _names(channels: Sequence[Channel]) -> str:
    return ", ".join(dict.fromkeys(c.name for c in channels))
