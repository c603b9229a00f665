"""Runs of the alignment kernel with rules and parameters outside the public ranges."""

import numpy as np

from navgym.deck import alignment as kernels
from navgym.deck import alignment_model, bank, hypotheses, joint
from navgym.deck.catalogue import CATALOGUE as DECK_CATALOGUE
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
    recordings, rule=None, flexures=None, everything=True,
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
    out = outputs_for(tapes, everything)
    kernels.run(lanes, models, tapes, rule_of(**(rule or {})), row, 1, *out)
    return named(*out) | {"lanes": lanes, "tapes": tapes}


def bank_lanes(recordings, kinds=hypotheses.KINDS, lever_sd=0.0):
    """Lanes (N, J + 1) of a bank at the start, models (N, 2) and tapes of recordings of one length."""
    tapes, _ = tapes_of(recordings)
    each = [alignment_model.pack(r, hypotheses.flexures_of(r.model)) for r in recordings]
    lanes = np.zeros((len(recordings), len(kinds) + 1), joint.LANE)
    hypotheses.begin(lanes, np.stack(each), kinds, np.full(len(recordings), lever_sd))
    return lanes, np.stack(each), tapes


def run_bank(recordings, kinds=hypotheses.KINDS, **columns):
    """Run the bank's kernel with modes of one's own; its outputs by name, and `lanes`, `tapes`.

    Columns that are not named are those of `deck_bank`'s defaults.
    """
    defaults = DECK_CATALOGUE["deck_bank"].space.array({})
    row = hypotheses.table_of(DECK_CATALOGUE["deck_bank"].space, defaults[None])
    for name, value in columns.items():
        row[..., bank.COLUMNS.index(name)] = value
    lanes, models, tapes = bank_lanes(recordings, kinds, columns.get("lever_sd", 0.0))
    out = hypotheses.outputs_for(*tapes.shape, len(kinds), everything=True)
    noise = hypotheses.NOTHING_KNOWN
    bank.run(lanes, models, kinds, tapes, 0, row, 1, *noise, *out.values())
    return named(out["states"], out["report"], out["covariances"]) | {
        "mode_weights": out["mode_weights"], "lagged": out["theta_rate_lagged"], "lanes": lanes, "tapes": tapes,
    }  # fmt: skip
