"""The demonstration: tune, compare on fresh recordings, replay real tracks, and tell what came out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import navgym
from navgym.auv.problem import PROBLEM, STEERED, TRACKS
from navgym.simulation import find_scenario
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry, compare
from navgym.tuning.experiments import (
    best_fixed,
    cross_tuned,
    error_by_regime,
    per_track,
    real_cases,
)
from navgym.tuning.objectives import Objective
from navgym.tuning.papers.contenders import UNTUNED, bank_beliefs, linear_filters, nonlinear_filters
from navgym.tuning.report import plots, tables, words
from navgym.tuning.report.page import SHORTENED, Figure, Page, Section, Table, Tile
from navgym.tuning.study.run import Interrupted, Outcome, Trial

SCENARIO, LOSS = "auv/switch-D", 0.3
MAIN, EXACT = "switch-D, 30 % lost", "nominal, 30 % lost"
DEFAULT, TUNED, UNTUNED_LABEL = "qivbf", "qivbf, tuned", "qivbf, untuned"
LEARN_NOTHING = ("bank", "imm", "imm_wide")
SHOWN = {"kf": plots.PLAIN, TUNED: plots.OWN, "imm": plots.MORE[0], "bank": plots.BEST}
BY_TRACKS = "{}, tuned on tracks"
ON_TRACKS = {
    "kf": plots.PLAIN,
    "kf_extrapolate": plots.MORE[0],
    "qivbf": plots.MORE[2],
    BY_TRACKS.format("qivbf"): plots.OWN,
    BY_TRACKS.format("vbakf"): plots.MORE[3],
    "bank": plots.BEST,
}
# what a study on tracks can vary; the straw men stay as they are
TUNABLE = ("kf", "kf_extrapolate", "vbakf", "qivbf", "imm", "imm_wide", "bank")


@dataclass(frozen=True)
class DemoAmount:
    """How much is run.

    Args:
        trials: of the study on the scenario.
        train: recordings per trial.
        test: fresh recordings to compare on.
        steps: samples per recording; None for the scenario's own.
        draws: noise and loss seeds per real track.
        track_trials: of each study on tracks.
    """

    trials: int
    train: int
    test: int
    steps: int | None
    draws: int
    track_trials: int


FULL = DemoAmount(trials=200, train=40, test=300, steps=None, draws=10, track_trials=60)
QUICK = DemoAmount(trials=20, train=40, test=60, steps=300, draws=2, track_trials=6)


@dataclass(frozen=True, eq=False)
class Tuning:
    """The study and what it chose."""

    goal: Objective
    outcome: Outcome
    chosen: Trial

    @property
    def values(self) -> dict[str, Any]:
        """The tuned parameters."""
        return dict(self.chosen.values)


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that the demo measured.

    Args:
        size: how much was run.
        tuning: the study.
        cases: the fresh recordings of the scenario.
        conditions: comparisons by simulated condition, the scenario first.
        turning: the nonlinear filters on their own scenario.
        tracks: comparisons by loss rate on real tracks, or their stand-in.
        real: whether the tracks are real.
    """

    size: DemoAmount
    tuning: Tuning
    cases: Cases
    conditions: Mapping[str, Comparison]
    turning: Comparison
    tracks: Mapping[str, Comparison]
    track_values: Mapping[str, Any]
    real: bool
    example: Figure
    track: Figure

    @property
    def main(self) -> Comparison:
        """The comparison on the scenario that was tuned for."""
        return next(iter(self.conditions.values()))


def run(size: DemoAmount, seed: int, out: Path, folder: Path | None) -> Findings:
    """The whole demo.

    Args:
        size: how much to run.
        seed: of the samplers.
        out: folder for the journal.
        folder: A-KIT's tracks; None for the simulated stand-in.

    Raises:
        Interrupted: Ctrl-C during the study; its finished trials are in the journal.
    """
    tuning = tune(size, seed, out)
    cases = Cases.simulated(SCENARIO, "test", size.test, steps=size.steps, loss=LOSS)
    conditions = simulated(tuning.values, cases, size)
    turning = compare(
        nonlinear_filters(),
        Cases.simulated("auv/coordinated-turn", "test", max(size.test // 3, 2), steps=size.steps),
        reference="ekf",
        plain="ekf",
        progress="coordinated turn",
    )
    tracks, values, figure = replayed(tuning.values, size, seed, folder)
    return Findings(
        size, tuning, cases, conditions, turning, tracks, values, folder is not None,
        _example(conditions[MAIN], cases), figure,
    )  # fmt: skip


def tune(size: DemoAmount, seed: int, out: Path) -> Tuning:
    """The study on the scenario, kept in `out`; continues one that was interrupted."""
    journal = out / f"study-loss{100 * LOSS:.0f}-{size.train}x{size.steps or 'all'}-seed{seed}.log"
    goal, outcome, chosen = best_fixed(
        SCENARIO, size.trials, seed, size.train, journal, steps=size.steps, loss=LOSS
    )
    if outcome.interrupted:
        raise Interrupted(outcome)
    return Tuning(goal, outcome, chosen)


def simulated(values: Mapping[str, Any], cases: Cases, size: DemoAmount) -> dict[str, Comparison]:
    """Every filter on the scenario that was tuned for, and where the model is right."""
    # without a fill, which the defaults leave off, qivbf is vbakf
    entries = [
        *(e for e in linear_filters(simulated=True) if e.filter != "vbakf"),
        Entry(TUNED, "qivbf", dict(values)),
        Entry(UNTUNED_LABEL, "qivbf", UNTUNED),
    ]
    exact = Cases.simulated("auv/nominal", "test", size.test, steps=size.steps)
    conditions = {MAIN: cases, EXACT: exact}
    return {
        name: compare(
            entries, chosen, "kf", keep=tuple(SHOWN) if chosen is cases else (), progress=name
        )
        for name, chosen in conditions.items()
    }


def replayed(
    values: Mapping[str, Any], size: DemoAmount, seed: int, folder: Path | None
) -> tuple[dict[str, Comparison], dict[str, Any], Figure]:
    """Every filter on the tracks: at its defaults, and tuned on the other half of them.

    Returns comparisons by loss rate, the tuned parameters, and a drawing of one track.
    """
    defaults = linear_filters(simulated=False)
    tunable = [e for e in defaults if e.filter in TUNABLE]
    tuned = {
        entry.filter: list(
            cross_tuned(PROBLEM, entry, folder, max(size.draws // 2, 1), size.track_trials, seed)
        )
        for entry in tqdm(tunable, desc="tuning on the other tracks")
    }
    found = {}
    for rate in TRACKS.rates:
        cases = real_cases(PROBLEM, folder, rate, size.draws, "test")
        entries = [
            *defaults,
            *(Entry(BY_TRACKS.format(f), f, per_track(cases, v)) for f, v in tuned.items()),
            Entry("qivbf, tuned on switch-D", "qivbf", dict(values)),
        ]
        name = f"{100 * rate:.0f} % lost"
        found[name] = compare(entries, cases, "kf", progress=f"tracks, {name}")
    shown = {
        f: [{"tracks": list(tracks), "parameters": v} for tracks, v in halves]
        for f, halves in tuned.items()
    }
    return found, shown, _track(cases, folder is not None)


# ---- what is shown


def page(found: Findings, provenance: Mapping[str, Any]) -> Page:
    """The report."""
    return Page(
        "Which filter holds an AUV's position when measurements get lost?",
        _lede(found),
        [
            _ladder(found), _in_time(found), _exact(found), _study(found), _tracks(found),
            _turning(found), _reading(),
        ],
        _tiles(found),
        provenance,
        SHORTENED if found.size == QUICK or found.size.steps is not None else "",
    )  # fmt: skip


def table(found: Findings) -> Table:
    """The ladder of the scenario that was tuned for."""
    return tables.ladder(found.main, own=(TUNED,))


NOW = (
    "now your log, a text file with a column time and any of px, vx, py, vy, lat, lon:\n"
    "    navgym inspect my.csv"
)


def vehicle() -> str:
    """What is simulated and what filters believe of it, in a sentence or two."""
    (recording,) = Cases.simulated(SCENARIO, "test", 1, steps=2, loss=LOSS).recordings
    model, speed = recording.model, float(np.hypot(*recording.model.x0[[1, 3]]))
    position, velocity = (float(np.sqrt(model.R[i, i])) for i in (0, 1))
    return (
        f"The vehicle, by table 2 of the QIVBF paper: an AUV at {speed:.1f} m/s that sends its position, to "
        f"{position:.3g} m, and its velocity, to {velocity:.3g} m/s, once a second (standard deviations on "
        "each axis while it is quiet)."
    )


def results(found: Findings, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Everything measured, as JSON; only "microseconds per filter step" depends on the machine."""
    tuning = found.tuning
    return {
        "provenance": dict(provenance),
        "size": asdict(found.size),
        "tuning": {
            "goal": tuning.goal.about,
            "trials": [asdict(t) | {"values": dict(t.values)} for t in tuning.outcome.trials],
            "chosen": {"number": tuning.chosen.number, "values": tuning.values},
            "chosen by": "RMSE on validation seeds among the leaders of the training seeds",
        },
        "conditions": {name: c.as_dict() for name, c in found.conditions.items()},
        "coordinated turn": found.turning.as_dict(),
        "tracks": {
            "real": found.real,
            "tuned on the other tracks": dict(found.track_values),
            "comparisons": {name: c.as_dict() for name, c in found.tracks.items()},
        },
        "microseconds per filter step": {
            k: round(v, 3) for k, v in found.main.microseconds.items()
        },
    }


def _lede(found: Findings) -> list[str]:
    main, tracks = found.main, found.tracks
    best, hardest = words.best(main), list(tracks)[-1]
    oracle = main["oracle"]
    where = "real AUV tracks (A-KIT)" if found.real else "simulated stand-ins for real tracks"
    on_tracks = words.best(tracks[hardest])
    return [
        vehicle(),
        f"In `{SCENARIO}`, where quiet stretches, outliers and manoeuvres follow one another and "
        f"{LOSS:.0%} of the samples are lost, the best estimate comes from **`{best.label}`**: {best.mean:.3f} m, "
        f"{100 * (best.mean / oracle.mean - 1):.1f} % above the {oracle.mean:.3f} m of the bound, "
        "a Kalman filter that is told the true noise of every sample. "
        + words.versus(main, TUNED, "kf")
        + " "
        + words.versus(main, TUNED, DEFAULT),
        words.without_learning(main, LEARN_NOTHING, TUNED),
        f"On {where} at {hardest} the smallest error is that of **`{on_tracks.label}`**, "
        f"{on_tracks.mean:.3f} m; predict-only `kf` has {tracks[hardest]['kf'].mean:.3f} m.",
    ]


def _tiles(found: Findings) -> list[Tile]:
    main = found.main
    best = words.best(main)
    chosen = [
        (best, "best", "best that can be had: `{}`"),
        (main[TUNED], "own", "{}"),
        (main[DEFAULT], "", "{}, shipped defaults"),
        (main["kf"], "", "{}, predict-only, nominal model"),
        (main["oracle"], "bound", "{}: bound, told the true noise"),
    ]
    return [Tile(f"{row.mean:.2f} m", text.format(row.label), kind) for row, kind, text in chosen]


def _ladder(found: Findings) -> Section:
    main = found.main
    caption = (
        f"Mean over {len(found.cases)} fresh recordings of each run's position RMSE, with its 95 % "
        "interval. Dashed: the bound. Pale and cut: diverges."
    )
    note = (
        "Gains are paired (same recordings), intervals from BCa bootstrap, p from sign flips. "
        "Score: 0 = predict-only Kalman filter, 1 = oracle. A run counts as diverged if it was "
        "flagged, failed, or is ten times worse than the oracle. Times per filter step are of this "
        "machine."
    )
    text = [
        "All filters run on the same recordings, none of which was used for tuning. `vbakf` is left "
        "out: it is `qivbf` without the fill, which the shipped defaults leave off."
    ]
    names, rms = error_by_regime(main, found.cases)
    regimes = Table(
        ["RMSE in m while the true regime is", *names],
        [[label, *(f"{x:.3f}" for x in values)] for label, values in rms.items()],
        "Over all samples of each regime, switches included.",
    )
    figure = plots.ladder(main, (TUNED,), caption)
    items: list[Table | Figure] = [figure, tables.ladder(main, (TUNED,), note), regimes]
    return Section("Every filter, on fresh recordings", text, items)


def _exact(found: Findings) -> Section:
    exact = found.conditions[EXACT]
    text = [
        f"The same filters with the same parameters in `auv/nominal`, which loses as much. "
        f"{words.nobody_better_than(exact, 'kf')} {words.versus(exact, DEFAULT, 'kf')} The defaults "
        "are one setting for the whole catalogue."
    ]
    caption = "Position RMSE in m, mean over runs, with the half-width of its 95 % interval."
    table = tables.by_condition({EXACT: exact}, (TUNED,), caption)
    return Section("When the model is right", text, [table])


def _in_time(found: Findings) -> Section:
    squared = {label: found.main.squared[label] for label in SHOWN}
    caption = (
        "RMSE over all recordings around the switch into each regime, with 95 % bands. What "
        "separates the filters is how soon they notice."
    )
    switches = plots.after_switch(found.cases.recordings, squared, SHOWN, caption)
    return Section("Error over time", [], [found.example, switches])


def _example(main: Comparison, cases: Cases) -> Figure:
    recording = cases.recordings[0]
    caption = (
        f"One recording (seed {recording.meta['seed']}): tint is the truth, which no filter sees; "
        "below, the probability that the bank gives to each regime."
    )
    squared = {label: main.squared[label][0] for label in SHOWN}
    return plots.example(recording, squared, SHOWN, bank_beliefs(recording), caption)


def _study(found: Findings) -> Section:
    tuning, count = found.tuning, len(found.tuning.outcome.trials)
    default = tuning.goal(tuning.goal.space.defaults)
    caption = (
        f"{count} trials of Optuna's TPE sampler, each the mean RMSE over "
        f"{len(tuning.goal.cases)} training recordings; the defaults were tried first."
    )
    text = [
        "A study varied "
        + words.listed(STEERED)
        + f" of `qivbf` on training seeds. Its leaders were run again on validation seeds, where "
        f"trial {tuning.chosen.number + 1} was best; all figures on this page are from test seeds."
    ]
    space = PROBLEM.find("qivbf").space
    shipped = dict(find_scenario(SCENARIO).reference)
    sets = {"untuned": UNTUNED, "default": space.defaults, "tuned here": tuning.values}
    sets["best known here"] = shipped
    note = (
        "The last column is the scenario's reference in the catalogue, from a longer study, without "
        "losses."
    )
    figure = plots.history(tuning.outcome, default, caption)
    return Section("What tuning found", text, [figure, tables.parameters(space, sets, note)])


def _tracks(found: Findings) -> Section:
    hardest = list(found.tracks)[-1]
    last = found.tracks[hardest]
    own = [BY_TRACKS.format(name) for name in TUNABLE]
    text = [
        _what_tracks(found),
        f"**{hardest}**: {words.versus(last, 'kf_extrapolate', 'kf')} "
        + words.versus(last, "bank", "kf")
        + " "
        + words.versus(last, DEFAULT, "kf"),
        *_tuned_tracks(found),
        "There is no bound here: nobody knows the true noise. Intervals are over runs; they speak "
        "of these tracks, not of every sea.",
    ]
    caption = "Position RMSE in m, mean over runs, with its 95 % interval."
    figure = plots.by_loss(found.tracks, list(ON_TRACKS), ON_TRACKS, caption)
    gains = Table(
        ["gain over kf", *found.tracks],
        [
            [r.label, *(tables.gain(c[r.label]) for c in found.tracks.values())]
            for r in sorted(last.rows, key=lambda r: r.mean)
            if r.label != "kf"
        ],
        "Paired, with 95 % intervals.",
    )
    title = "Real tracks" if found.real else "Simulated tracks in place of real ones"
    errors = tables.by_condition(found.tracks, own, caption, order=hardest)
    return Section(title, text, [found.track, figure, errors, gains])


def _tuned_tracks(found: Findings) -> list[str]:
    """What tuning on the other half of the tracks brought."""
    hardest = list(found.tracks)[-1]
    last = found.tracks[hardest]
    text = [
        f"Rows “{BY_TRACKS.format('…')}” ran with parameters tuned on the other half of the tracks, "
        "all loss rates together, on other noise and losses. "
        + " ".join(words.versus(last, BY_TRACKS.format(n), n) for n in ("kf", "bank", "qivbf"))
        + f" ({hardest}.)"
    ]
    flat = [n for n in TUNABLE if not last.difference(BY_TRACKS.format(n), n).gain_low > 0.0]
    if flat:
        text[0] += f" It did not measurably help {words.listed(flat)}."
    vb = [BY_TRACKS.format(n) for n in ("vbakf", "qivbf")]
    better = [
        n for n in vb if all(c.difference(n, "bank").gain_low > 0 for c in found.tracks.values())
    ]
    if better:
        text.append(
            f"{words.listed(better)} beat the `bank` at every loss rate here. A likely reason: a "
            "variational filter estimates whole covariance matrices, each component on its own, "
            "where the banks only scale Q and R, and a real velocity log is not off by a scale."
        )
    return text


def _what_tracks(found: Findings) -> str:
    runs = len(next(iter(last for last in found.tracks.values())).errors["kf"])
    if not found.real:
        return (
            "**The A-KIT data were not found, so these tracks are simulated stand-ins** with "
            "unmodelled turns and the same noise model; name the data's folder with `--data`. "
            f"{len(TRACKS.numbers)} tracks, {runs} runs per loss rate."
        )
    return (
        f"Tracks 1-6 of the Snapir AUV (A-KIT, github.com/ansfl/A-KIT): real Doppler velocity, "
        "position fixes made from the post-processed reference with 1 m of noise, independent "
        f"losses; {found.size.draws} draws of noise and losses per track, {runs} runs per loss rate. "
        "The filters believe white acceleration of .1 m/s²."
    )


def _track(cases: Cases, real: bool) -> Figure:
    recording = cases.recordings[0]
    labels = ("kf", "kf_extrapolate", "bank")
    states = {label: navgym.estimate(label, recording).states for label in labels}
    kind = "Track" if real else "Stand-in for track"
    caption = (
        f"{kind} {recording.meta['track']} with {100 * recording.lost.mean():.0f} % of the samples "
        "lost. The reference is seen by no filter."
    )
    return plots.track(recording, states, ON_TRACKS, caption)


def _turning(found: Findings) -> Section:
    rows = [r.label for r in found.turning.rows if r.label != found.turning.reference]
    differ = [r for r in rows if not _alike(found.turning, r)]
    verdict = (
        f"{words.listed(rows)} and `{found.turning.reference}` agree within their intervals."
        if not differ
        else " ".join(words.versus(found.turning, r, found.turning.reference) for r in differ)
    )
    text = [
        "Range, bearing, speed and heading from a beacon, with 30 % of the samples lost: the "
        "sigma-point filters, the paper's `cukf` among them, against the extended Kalman filter. "
        + verdict
    ]
    return Section("Nonlinear filters on a coordinated turn", text, [tables.ladder(found.turning)])


def _alike(found: Comparison, label: str) -> bool:
    d = found.difference(label, found.reference)
    return abs(d.relative_gain) < 0.01 or d.gain_low <= 0.0 <= d.gain_high


def _reading() -> Section:
    rows = [[f.name, f.summary] for f in PROBLEM.filters.values()]
    rows += [
        [TUNED, "qivbf with the parameters that this demo's study found"],
        [UNTUNED_LABEL, "qivbf as a reader of the paper would first set it"],
    ]
    return Section("The filters", [], [Table(["filter", "what it is"], rows, text_columns=(0, 1))])
