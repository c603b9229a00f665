"""What can be asked of a study, and what is refused at once."""

import re
from pathlib import Path

import pytest

import navgym
from navgym.problem import PROBLEMS
from navgym.tuning import declared
from navgym.tuning.commands import parse as command
from navgym.tuning.settings import StudySettings
from navgym.tuning.stages import stages

LOG = "time,px,vx,py,vy\n" + "".join(f"{k},{k},1,{2 * k},2\n" for k in range(40))


def parse(*arguments):
    default, rest = command.configured(StudySettings, arguments)
    return command.parse(StudySettings, "tune", "doc", rest, default)


def test_without_arguments_the_variational_filter_is_tuned_on_switching_noise():
    settings = parse()
    assert settings == StudySettings()
    assert [p.name for p in settings.parameters()] == [
        "vb_iterations", "prior_count", "forgetting", "process_noise_scale",
    ]  # fmt: skip


def test_flags_say_what_is_varied_held_and_where():
    settings = parse(
        "--filter", "qivbf", "--free", "forgetting", "process_noise_scale", "--fix", "fill", "extrapolate",
        "vb_iterations", "3", "--range", "process_noise_scale", "1", "50",
        "--overrides", "loss", "0.3",
    )  # fmt: skip
    forgetting, process = settings.parameters()
    assert forgetting.name == "forgetting"
    assert (process.low, process.high) == (1.0, 50.0)
    assert settings.fixed() == {"fill": "extrapolate", "vb_iterations": 3}
    assert stages(settings).train["auv/switch-D"].about["overrides"] == {"loss": "0.3"}


def names(settings):
    cases = stages(settings).train
    return [p.name for p in settings.parameters(next(iter(cases.values())).space(settings.filter))]


def test_on_a_log_of_two_sensors_each_has_a_noise_scale(tmp_path):
    log, fixes = tmp_path / "log.csv", tmp_path / "fixes.csv"
    log.write_text(LOG)
    fixes.write_text("time,px,py\n" + "".join(f"{k},{k}.5,{2 * k}.5\n" for k in range(40)))
    # what scales all of R is seen by no one-step error; it is set by NIS afterwards
    both = ["process_noise_scale", "velocity_noise_scale"]
    assert names(StudySettings(filter="kf", log=(log,))) == both
    assert names(StudySettings(filter="kf", log=(fixes,))) == ["process_noise_scale"]
    likely = names(StudySettings(filter="kf", log=(fixes,), measure="likelihood"))
    assert likely == ["process_noise_scale", "measurement_noise_scale"]
    assert "position_noise_scale" not in names(StudySettings(filter="qivbf", log=(log,)))
    asked = StudySettings(filter="kf", log=(log,), range={"position_noise_scale": (0.1, 10.0)})
    assert "position_noise_scale" in names(asked)
    own = StudySettings(filter="kf", log=(log,), free=("velocity_noise_scale",))
    assert names(own) == ["velocity_noise_scale"]
    wrong = StudySettings(filter="kf", log=(log,), free=("velocty_noise_scale",))
    with pytest.raises(ValueError, match="Did you mean 'velocity_noise_scale'"):
        names(wrong)
    assert [p.name for p in StudySettings(filter="kf").parameters()] == ["process_noise_scale", "measurement_noise_scale"]  # fmt: skip


def test_noise_scales_may_go_beyond_their_usual_range_with_a_word(tmp_path):
    wide = StudySettings(filter="kf", range={"process_noise_scale": (1e-5, 10.0)})
    (said,) = wide.beyond()
    assert said == "process_noise_scale is searched from 1e-05 to 10, beyond its usual 0.1 to 1000"
    assert StudySettings(filter="kf", range={"process_noise_scale": (1.0, 10.0)}).beyond() == []
    with pytest.raises(ValueError, match=r"range of forgetting must be low < high inside 0\.6"):
        StudySettings(range={"forgetting": (0.1, 0.9)})
    log = tmp_path / "log.csv"
    log.write_text(LOG)
    for p in StudySettings(filter="kf", log=(log,)).parameters():
        assert (p.low, p.high) == (
            1e-4,
            1e4,
        )  # a log's model is the reader's default as often as not


@pytest.mark.parametrize("name", ["auv", "deck", "ins"])
def test_every_filter_can_be_tuned_on_a_log_within_what_is_admissible(name, tmp_path):
    problem = PROBLEMS[name]
    scenario = problem.full_name(next(iter(problem.scenarios.values())))
    log = navgym.simulate(scenario, **problem.brief).save(tmp_path / "log.npz")
    tried = 0
    for own, chosen in problem.filters.items():
        if len(chosen.space) and own != problem.bound:
            for p in StudySettings(filter=own, log=(log,)).parameters(chosen.space):
                least, most = p.admissible
                assert least <= p.low < p.high <= most
                tried += 1
    assert tried > 3


def test_a_file_holds_what_flags_say_and_flags_override_it(tmp_path):
    asked = parse("--trials", "7", "--scenario", "auv/heavy", "--fix", "vb_iterations", "3",
                  "--range", "forgetting", "0.7", "0.9", "--out", str(tmp_path))  # fmt: skip
    path = tmp_path / "settings.toml"
    path.write_text(declared.to_toml(declared.own(asked)))
    assert parse("--config", str(path)) == asked
    assert parse("--config", str(path), "--trials", "9").trials == 9


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"filter": "qivf"}, "Did you mean 'qivbf'"),
        ({"scenario": ("auv/havy",)}, "Did you mean 'auv/heavy'"),
        ({"scenario": ()}, "at least one scenario"),
        ({"free": ("forgeting",)}, "Did you mean 'forgetting'"),
        ({"range": {"forgetting": (0.9, 0.7)}}, "range of forgetting must be low < high"),
        ({"range": {"forgetting": (0.9, 0.9)}}, "range of forgetting must be low < high"),
        ({"range": {"fill": (0, 1)}}, "unknown free parameter 'fill'"),
        ({"fix": {"forgetting": "3"}}, "forgetting must lie in"),
        ({"free": ("fill",), "fix": {"fill": "skip"}}, "free and fixed"),
        ({"trials": 0}, "trials must be a whole number of at least 1, got 0"),
        ({"batch": 0}, "batch must be a whole number of at least 1"),
        ({"metric": "maen"}, "Did you mean 'mean'"),
        ({"measure": "rmsee"}, "Did you mean 'rmse'"),
        ({"sampler": "tpee"}, "Did you mean 'tpe'"),
        ({"filter": "alignment_mcc"}, "different problems"),
        ({"report_log": (Path("x.csv"),)}, "needs --log"),
        ({"filter": "oracle"}, "nothing to tune"),
    ],
)
def test_a_bad_request_is_refused_with_its_remedy(asked, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        StudySettings(**asked)


def test_a_filter_and_logs_of_different_problems_are_refused(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(LOG)
    with pytest.raises(ValueError, match=r"logs of format 'csv' are of different problems.*deck/"):
        StudySettings(filter="alignment", log=(log,))
    with pytest.raises(ValueError, match="Did you mean 'deck_csv'"):
        StudySettings(filter="alignment", log=(log,), format="deck-csv")
    with pytest.raises(ValueError, match="are of different problems"):
        StudySettings(filter="oracle", scenario=("deck/paper", "auv/nominal"))


def test_a_bad_flag_ends_the_command_with_the_same_words(capsys):
    with pytest.raises(SystemExit) as stopped:
        parse("--trials", "0")
    assert stopped.value.code == 2
    assert "trials must be a whole number of at least 1" in capsys.readouterr().err


def test_a_missing_log_and_a_bad_file_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no log at .*none\.csv"):
        parse("--log", str(tmp_path / "none.csv"))
    path = tmp_path / "settings.toml"
    path.write_text('trials = "many"\n')
    with pytest.raises(ValueError, match="trials must be of type int, got 'many'"):
        parse("--config", str(path))
    path.write_text("trails = 3\n")
    with pytest.raises(ValueError, match="Did you mean 'trials'"):
        parse("--config", str(path))
    path.write_text("trials = \n")
    with pytest.raises(ValueError, match="is not TOML"):
        parse("--config", str(path))


def test_the_stages_of_a_simulation_share_no_seed():
    found = stages(StudySettings(runs=3, select_runs=4, report_runs=5, steps=5))
    seeds = [
        set(range(first, last + 1))
        for stage in (found.train, found.select, found.report)
        for first, last in [stage["auv/switch-D"].about["seeds"]]
    ]
    assert [len(s) for s in seeds] == [3, 4, 5]
    assert len(set().union(*seeds)) == 12


def test_the_stages_of_a_log_share_no_sample(tmp_path):
    log, other = tmp_path / "log.csv", tmp_path / "other.csv"
    for path in (log, other):
        path.write_text(LOG)
    alone = stages(StudySettings(filter="kf", log=(log,)))
    spans = [stage["logs"].span for stage in (alone.train, alone.select, alone.report)]
    assert spans == [(0.0, 0.5), (0.5, 0.7), (0.7, 1.0)]
    two = stages(StudySettings(filter="kf", log=(log,), report_log=(other,)))
    assert two.report["logs"].span == (0.0, 1.0)
    assert two.report["logs"].about["logs"][0].startswith("other.csv (")


def test_a_log_that_changed_is_another_study(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(LOG)
    before = stages(StudySettings(filter="kf", log=(log,))).train["logs"].about
    log.write_text(LOG.replace("39,39,1", "39,38,1"))
    from navgym.tuning.study.recipes import remake

    remake.cache_clear()
    assert stages(StudySettings(filter="kf", log=(log,))).train["logs"].about != before


def test_tracks_are_tuned_on_one_half_and_reported_on_the_other(akit):
    found = stages(StudySettings(akit=akit, runs=1, select_runs=1, report_runs=1))
    for rate in ("10% lost", "30% lost", "50% lost"):
        assert found.train[rate].about["tracks"] == [1, 2, 3]
        assert found.select[rate].about["split"] == "validation"
        assert found.report[rate].about["tracks"] == [4, 5, 6]
        assert found.report[rate].about["split"] == "test"
