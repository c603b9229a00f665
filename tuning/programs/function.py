"""A study of any function: `(recording, parameters) -> estimate`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from navgym.tuning.programs import report, study
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.settings import ProgramSettings
from navgym.tuning.programs.study import ProgramFindings


def tune(
    call: Callable[[Any, Mapping[str, Any]], Any],
    log: Sequence[Any],
    parameters: Mapping[str, Mapping[str, Any]] | str | Path,
    select_log: Sequence[Any] = (),
    report_log: Sequence[Any] = (),
    output: Mapping[str, Any] | None = None,
    **settings: Any,
) -> ProgramFindings:
    """Tune a function over recordings; writes what `navgym tune` writes to the folder `out`.

    Args:
        call: takes a recording and a dict of parameters, and returns columns by name (a dict, a frame):
            `time` and `innovation` with `variance`, `nis`, `log_likelihood`, or `estimate` with
            `reference`. What it raises is a run that failed. With more than one worker it must stand in a
            module. No time-out can be kept for it: a program has one.
        log: recordings to tune on, or paths; anything that `call` takes and that can be pickled.
        parameters: tables by name, with range and default, or a TOML file as for `navgym tune --program`.
        select_log: recordings that choose among the leaders.
        report_log: recordings that are reported on.
        output: what columns mean, as the table [output] says it.
        settings: fields of `ProgramSettings`, such as trials, workers, measure, out.

    Raises ValueError as `navgym.tuning.programs.study.run`.
    """
    if isinstance(parameters, (str, Path)):
        contract = Contract.load(Path(parameters))
    else:
        contract = Contract.of_dict({"parameters": parameters, "output": dict(output or {})})
    name = getattr(call, "__name__", type(call).__name__)
    paths = {key: Path(settings[key]) for key in ("out", "start") if settings.get(key) is not None}
    asked = ProgramSettings(**{"name": name, **settings, **paths})
    given = {"log": log, "select_log": select_log, "report_log": report_log}
    found = study.run(asked, call, given, contract)
    report.write(found, f"navgym.tuning.programs.function.tune({name}, ...)")
    return found
