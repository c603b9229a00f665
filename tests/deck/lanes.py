"""Runs of the alignment kernel with rules and parameters outside the public ranges."""

import numpy as np

from navgym.deck import alignment as kernels
from navgym.deck import alignment_model
from navgym.deck.mechanization import tapes_of

REPORT = kernels.REPORT.names
OFF = dict(zip(kernels.COLUMNS, kernels.OFF, strict=True))


def prepare(recordings, flexures=None, **parameters):
    """Lanes, models, tapes and the table (1, 1, 4) of a run; keywords are kernel columns."""
    tapes, lengths = tapes_of(recordings)
    models = np.stack([alignment_model.pack(r, flexures) for r in recordings])
    row = np.array([[list((OFF | parameters).values())]])
    lanes = np.zeros(len(recordings), kernels.LANE)
    kernels.begin(lanes, models, row[:, 0])
    lanes["length"] = lengths
    return lanes, models, tapes, row


def rule_of(**rule):
    """RULE (1,) of the kernel, judged and with one iteration unless told otherwise."""
    found = np.zeros(1, kernels.RULE)
    for name, value in ({"iterations": 1, "judged": 1} | rule).items():
        found[name] = value
    return found


def outputs_for(tapes, everything=True):
    """NaN arrays for the kernel to fill: states, reports and covariances."""
    count, steps = tapes.shape
    rest, n = steps if everything else 0, kernels.STATES
    return [
        np.full((count, steps, n), np.nan),
        np.full((count, rest), np.nan, kernels.REPORT),
        np.full((count, rest, n, n), np.nan),
    ]


def named(states, report, covariances):
    """Outputs of one lane or of all by the names of a DeckEstimate."""
    return {
        "states": states, "covariances": covariances, "innovations": report["innovation"],
    } | {name: report[name] for name in REPORT if name != "innovation"}  # fmt: skip


def run_alignment(
    recordings, rule=None, flexures=None, impulse=None, disturbance=None, everything=True,
    change=None, **parameters,
):  # fmt: skip
    """Run all recordings; the named outputs (N, K, ...) and `lanes`, `tapes`.

    Args:
        rule: fields of RULE by name.
        flexures: models that `tape.model` selects from; the believed one by default.
        change: function of the tapes that alters them before the run.
        parameters: kernel columns by name; what is not named is off.
    """
    lanes, models, tapes, row = prepare(recordings, flexures, **parameters)
    if change is not None:
        change(tapes)
    count = len(recordings)
    impulse = np.zeros((count, 0, 3)) if impulse is None else impulse
    disturbance = np.zeros((count, 0, 6)) if disturbance is None else disturbance
    out = outputs_for(tapes, everything)
    kernels.run(lanes, models, tapes, rule_of(**(rule or {})), row, 1, impulse, disturbance, *out)
    return named(*out) | {"lanes": lanes, "tapes": tapes}
