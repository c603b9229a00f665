"""One set of reader options: as keywords, as words of a command line, and in a mapping file."""

import dataclasses
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

import navgym
from navgym import command
from navgym.auv.csv_log import write_csv
from navgym.core.typed import described, options_of, paired, typed
from navgym.deck.csv_log import read_deck_csv, write_deck_csv
from navgym.deck.model import DeckModel
from navgym.readers import ReaderOptions, formats, guess, reader_of

LOG = "time;north (m);vx;py\n" + "".join(f"{k};{k};1;{2 * k}\n" for k in range(20))


@pytest.fixture
def log(tmp_path):
    """A log whose reader has to be told something."""
    path = tmp_path / "mine.csv"
    path.write_text(LOG)
    return path


@pytest.fixture(scope="module")
def ship():
    """Four seconds of a deck."""
    return navgym.simulate("deck/paper", seed=1, duration=4.0)


# ---- words


class TestWords:
    @given(st.floats(allow_nan=False, allow_infinity=False))
    def test_a_number_is_itself(self, value):
        assert typed(float, repr(value), "x") == value
        assert typed(float | None, value, "x") == value

    @given(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=5))
    def test_an_array_is_numbers_with_commas_between(self, values):
        text = ",".join(map(repr, values))
        assert typed(ArrayLike, text, "x") == typed(Sequence[float], text, "x") == tuple(values)

    @pytest.mark.parametrize(
        ("hint", "word", "value"),
        [
            (bool, "true", True),
            (bool | None, "none", None),
            (int, "3", 3),
            (float | str, "x", "x"),
            (float | str, "1e3", 1000.0),
            (Sequence[str | float], "-9999,lost", (-9999.0, "lost")),
            (tuple[float, float, float], "(1, 2, 3)", (1.0, 2.0, 3.0)),
            (list[int], "4", [4]),
            (ArrayLike | None, "4", 4.0),
            (str, "\\t", "\t"),
            (str, "none", "none"),
            (Literal["a", "b"], "b", "b"),
            (Path, "a/b", Path("a/b")),
            (Any, "1,2", (1.0, 2.0)),
            (Any, "text", "text"),
        ],
    )
    def test_the_hint_says_what_a_word_means(self, hint, word, value):
        assert typed(hint, word, "x") == value

    @pytest.mark.parametrize(
        ("hint", "value", "message"),
        [
            (float, "five", "x must be a number, got 'five'"),
            (float, "1_000", "x must be a number"),
            (float, "inf", "x must be a number"),
            (float, True, "x must be a number, got True"),
            (int, "2.5", "x must be a whole number, got '2.5'"),
            (bool, "1.5", "x must be true or false"),
            (str, 3, "x must be text, got 3"),
            (Literal["deg", "rad"], "dag", "Did you mean 'deg'"),
            (tuple[float, float], "1,2,3", "x must be 2 values with commas between"),
            (Mapping[str, float], "3", r"x must be a table \(NAME.KEY VALUE\)"),
            (Mapping[str, float], {"a": "b"}, r"x must be a table .*got \{'a': 'b'\}"),
            (DeckModel, {"levers": "1"}, "unknown field of x: 'levers'. Did you mean 'lever_arm'"),
            (DeckModel, {"flexure.sigma": "1"}, "needs x.flexure.damping, x.flexure.stiffness"),
            (ArrayLike, "a,b", "x must be numbers with commas between"),
            (ArrayLike, "", "x must be numbers with commas between"),
        ],
    )
    def test_what_does_not_fit_is_named_with_what_would(self, hint, value, message):
        with pytest.raises(ValueError, match=message):
            typed(hint, value, "x")

    def test_a_table_may_be_a_dataclass_of_dataclasses(self):
        words = paired(["m.rate_noise", "1e-3", "m.flexure.damping", "1", "m.flexure.stiffness",
                        "2,2,2", "m.flexure.sigma", "3"])  # fmt: skip
        model = typed(DeckModel, words["m"], "m")
        assert model.rate_noise == 1e-3
        assert model.flexure.stiffness.tolist() == [2, 2, 2]

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["a"], "'a' stands alone: give its value"),
            (["a", "1", "b"], "'b' stands alone"),
            (["a", "1", "a", "2"], "'a' is given twice"),
            (["a.b", "1", "a.b", "2"], "'a.b' is given twice"),
            (["a", "1", "a.b", "2"], "'a.b' is given twice"),
            (["a.", "1"], "'a.' names no option"),
            ([".a", "1"], "'.a' names no option"),
        ],
    )
    def test_words_come_in_pairs_each_once(self, words, message):
        with pytest.raises(ValueError, match=message):
            paired(words)

    @pytest.mark.parametrize("name", formats())
    def test_every_option_of_every_reader_can_be_said(self, name):
        for option, hint in options_of(reader_of(name)).items():
            assert "no text" not in described(hint), option


# ---- the same by keywords, words, and files


class TestOneSetOfOptions:
    def test_words_are_keywords(self, log):
        words = ("position_noise", "5", "columns.px", "north (m)", "delimiter", ";")
        told = ReaderOptions.parsed(words).read(log)
        same = navgym.read(
            "csv", log, position_noise=5.0, columns={"px": "north (m)"}, delimiter=";"
        )
        assert np.array_equal(told.measurements, same.measurements)
        assert np.array_equal(told.model.R, same.model.R)
        assert told.meta == same.meta

    def test_a_mapping_file_is_keywords_too_and_words_go_before_it(self, log, tmp_path):
        path = tmp_path / "mapping.toml"
        path.write_text(
            'format = "csv"\ndelimiter = ";"\nvelocity_noise = 0.3\n'
            '[column."north (m)"]\nquantity = "px"\nnoise = 5\n'
        )
        same = navgym.read(
            "csv", log, position_noise=5.0, columns={"px": "north (m)"}, delimiter=";",
            velocity_noise=0.3,
        )  # fmt: skip
        assert np.array_equal(navgym.read(path, log).model.R, same.model.R)
        told = ReaderOptions.parsed([str(path), "position_noise", "7"])
        assert told.read(log).model.R[0, 0] == 49.0
        assert navgym.read(str(path), log, position_noise=7).model.R[0, 0] == 49.0

    def test_a_model_is_that_of_a_saved_recording(self, log, tmp_path):
        first = navgym.read("csv", log, delimiter=";", columns={"px": "north (m)"})
        saved = first.save(tmp_path / "mine.npz")
        words = ("model", str(saved), "delimiter", ";", "columns.px", "north (m)")
        model = ReaderOptions.parsed(words).read(log).model
        assert np.array_equal(model.R, first.model.R)
        with pytest.raises(ValueError, match=r"model must be a recording that was saved as NAME\.npz"):  # fmt: skip
            ReaderOptions.parsed(("model", "kf")).options("csv")

    def test_all_that_a_deck_reader_is_told_can_be_words(self, ship, tmp_path):
        path = write_deck_csv(ship, tmp_path / "ship.csv", "rad/s")
        words = ("lever_arm", "1,2,3", "gyro_unit", "rad/s", "samples_per_step", "4", "regular",
                 "true", "longest_gap", "0.5", "deviation1", "0,0.1,0", "model.rate_noise", "1e-3")  # fmt: skip
        model = ReaderOptions.parsed(words).read(path).model
        assert model.lever_arm.tolist() == [1, 2, 3]
        assert (model.samples_per_step, model.rate_noise) == (4, 1e-3)

    def test_they_travel_to_other_processes_and_can_be_compared(self):
        told = ReaderOptions.parsed(["position_noise", "5"])
        assert pickle.loads(pickle.dumps(told)) == told
        assert hash(told) != hash(ReaderOptions())
        assert dataclasses.replace(told, format="csv").format == "csv"

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (("posision_noise", "5"), "unknown option of format 'csv': 'posision_noise'. Did you mean 'position_noise'.* Known: .*velocity_noise"),
            (("position_noise", "five"), "position_noise must be a number, got 'five'"),
            (("columns.px", "nord"), "unknown column of mine.csv: 'nord'"),
        ],
    )  # fmt: skip
    def test_a_wrong_word_is_named_with_what_there_is(self, log, words, message):
        with pytest.raises(ValueError, match=message):
            ReaderOptions.parsed(words).read(log)

    def test_only_some_options_make_sense_elsewhere(self):
        told = ReaderOptions.parsed(("sort", "true"))
        with pytest.raises(ValueError, match=r"unknown option of format 'csv': 'sort'.*Known: columns, units"):  # fmt: skip
            told.options("csv", among=("units", "columns"))

    def test_an_error_of_a_reader_says_how_words_mend_it(self, ship, tmp_path):
        path = write_deck_csv(ship, tmp_path / "ship.csv")
        with pytest.raises(ValueError, match="On a command line: --read lever_arm VALUE"):
            ReaderOptions().read(path)


class TestMappingFiles:
    def test_a_column_says_all_that_is_its_own(self, tmp_path):
        path = tmp_path / "m.toml"
        path.write_text(
            "missing = [-9999]\n"
            '[column.E]\nquantity = "px"\nframe = "enu"\nunit = "km"\nlatency = 0.5\n'
            'accuracy = "sigma E"\nlever_arm = [1, 0.5]\n'
            '[column.N]\nquantity = "py"\nframe = "enu"\nnoise = 3\n'
            '[column.lat]\nquantity = "lat"\naccuracy = "hacc"\n'
        )
        assert ReaderOptions.parsed([str(path)]).options("csv") == {
            "missing": (-9999.0,),
            "columns": {
                "py": "E", "sigma_py": "sigma E", "px": "N", "lat": "lat", "sigma_position": "hacc",
            },
            "units": {"py": "km"},
            "latency": {"py": 0.5},
            "lever_arm": (1.0, 0.5),
            "position_noise": 3.0,
        }  # fmt: skip

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("a = ", "is not TOML"),
            ("a = " + "[" * 5000, "is not TOML"),
            ("format = 3", "format must be text, got 3"),
            ('format = "cvs"', "unknown format 'cvs'. Did you mean 'csv'"),
            ("position_nois = 3", "unknown key of .*m.toml: 'position_nois'. Did you mean"),
            ('position_noise = "x"', "m.toml: position_noise must be a number, got 'x'"),
            ("column = 3", "column must be tables"),
            ("[column.a]\nunit = 'm'", r"\[column.'a'\] must say what it holds"),
            ("[column.a]\nquantity = 3", r"\[column.'a'\] must say what it holds"),
            ("[column.a]\nquantity='px'\nnois=3", r"unknown key in .*\[column.'a'\]: 'nois'. Did you mean 'noise'"),
            ("[column.a]\nquantity='px'\nnoise='x'", r"\[column.'a'\] noise must be a number"),
            ("[column.a]\nquantity='px'\nframe='esd'", r"unknown frame in .*\[column.'a'\]: 'esd'"),
            ("[column.a]\nquantity='px'\nsensor='x'", r"unknown sensor in .*Known: position, velocity"),
            ("[column.a]\nquantity='px'\n[column.b]\nquantity='px'", "'b'.* and 'a' both hold 'px'"),
            ("[column.a]\nquantity='px'\nnoise=1\n[column.b]\nquantity='py'\nnoise=2", "position_noise = 2.0, and something above it 1.0"),
        ],
    )  # fmt: skip
    def test_a_fault_names_file_key_value_and_remedy(self, log, tmp_path, text, message):
        path = tmp_path / "m.toml"
        path.write_text(text)
        with pytest.raises(ValueError, match=message) as error:
            navgym.read(path, log)
        assert "m.toml" in str(error.value) or "format" in text

    def test_a_missing_file_is_named(self, tmp_path):
        with pytest.raises(FileNotFoundError, match=r"no mapping file at .*none\.toml"):
            ReaderOptions.parsed([str(tmp_path / "none.toml")])


# ---- which format


class TestFormats:
    def test_a_saved_recording_is_known_by_what_it_holds(self, ship, tmp_path):
        walk = navgym.simulate("auv/turn", seed=1, steps=9)
        for recording, problem in ((walk, "auv"), (ship, "deck")):
            path = recording.save(tmp_path / "mine")
            assert guess(path) == "npz"
            assert ReaderOptions().problem(path).name == problem
            assert type(navgym.read("npz", path).model) is type(recording.model)

    def test_a_text_is_a_deck_s_by_its_columns_or_what_is_said_of_them(self, ship, log, tmp_path):
        path = write_deck_csv(ship, tmp_path / "ship.csv")
        assert guess(path) == "deck_csv"
        assert guess(log) == "csv"
        assert ReaderOptions.parsed(("columns.main_gyro_x", "gx")).format_of(log) == "deck_csv"

    def test_public_folders_are_known_by_their_files(self, tmp_path):
        for name, file in (
            ("akit", "GT_trajectory3.csv"),
            ("repoimu", "Pendulum_Test01_Trial1_Segment_1.csv"),
            ("multi_imu", "path_2_IMU_1.csv"),
        ):
            (tmp_path / name).mkdir()
            (tmp_path / name / file).touch()
            assert guess(tmp_path / name) == name
        (tmp_path / "else").mkdir()
        with pytest.raises(ValueError, match=r"else is a folder of no format that is known.*akit"):
            guess(tmp_path / "else")
        with pytest.raises(FileNotFoundError, match="no log at"):
            guess(tmp_path / "nowhere")

    def test_a_recording_of_nobody_is_named(self, tmp_path):
        np.savez(tmp_path / "x.npz", a=np.zeros(3))
        with pytest.raises(ValueError, match=r"x\.npz is an npz file but not a navgym recording"):
            navgym.read("npz", tmp_path / "x.npz")


# ---- navgym read


class TestCommand:
    def said(self, capsys, *words):
        assert command.main(["read", *map(str, words)]) == 0
        return dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())

    def test_ten_lines_say_what_was_read(self, capsys, tmp_path):
        recording = navgym.simulate("auv/position-only", seed=1, steps=50, loss=0.3)
        path = write_csv(recording, tmp_path / "log.csv")
        said = self.said(capsys, path, "--read", "position_noise", "1.5")
        assert said["rows"].startswith("50 over 49 s")
        assert said["step"].startswith("1 s (median)")
        lost = recording.lost[:, 0].mean()
        assert f"position (2) {lost:.1%} lost" in said["measured"]
        assert "position 1.5" in said["model"]
        assert said["next"] == f"navgym tune --filter kf --log {path} --read position_noise 1.5"

    def test_what_is_saved_is_what_was_read(self, capsys, log, tmp_path):
        words = ("--read", "delimiter", ";", "columns.px", "north (m)")
        self.said(capsys, log, *words, "--out", tmp_path / "mine.npz")
        saved = navgym.read("npz", tmp_path / "mine.npz")
        again = ReaderOptions.parsed(words[1:]).read(log)
        assert np.array_equal(saved.measurements, again.measurements)
        assert "meta" not in self.said(capsys, tmp_path / "mine.npz")

    def test_a_mapping_file_to_go_on_from_says_what_was_found(self, capsys, log, tmp_path):
        mapping = tmp_path / "m.toml"
        words = ("--read", "columns.px", "north (m)", "position_noise", "3", "missing", "-99,x")
        self.said(capsys, log, *words, "--write-mapping", mapping)
        by_words, by_file = (ReaderOptions.parsed(w) for w in (words[1:], [str(mapping)]))
        assert {**by_file.options("csv"), "columns": {}} == {
            **by_words.options("csv"), "columns": {},
        }  # fmt: skip
        assert np.array_equal(by_file.read(log).measurements, by_words.read(log).measurements)
        assert command.main(["read", str(log), "--write-mapping", str(mapping)]) == 2
        assert "exists: name another file" in capsys.readouterr().err

    def test_columns_that_nobody_knows_are_to_be_filled_in(self, capsys, tmp_path):
        (tmp_path / "log.csv").write_text('when;a "q";ü\n0;1;2\n1;2;3\n')
        mapping = tmp_path / "m.toml"
        words = ["read", str(tmp_path / "log.csv"), "--write-mapping", str(mapping)]
        assert command.main(words) == 2
        assert f"Say what the columns hold in {mapping}" in capsys.readouterr().err
        text = mapping.read_text(encoding="utf-8")
        for quantity in ("time", "px", "py"):
            text = text.replace("# [column", "[column", 1)
            text = text.replace('# quantity = ""', f'quantity = "{quantity}"', 1)
        mapping.write_text(text, encoding="utf-8")
        assert navgym.read(mapping, tmp_path / "log.csv").measurements.tolist() == [[1, 2], [2, 3]]

    def test_values_may_begin_with_a_dash(self, capsys, ship, tmp_path):
        path = write_deck_csv(ship, tmp_path / "ship.csv")
        assert "lever arm -1, 2, -3 m" in self.said(capsys, path, "--read", "lever_arm", "-1,2,-3")["model"]  # fmt: skip

    def test_what_is_not_linear_has_a_model_too(self, capsys, tmp_path):
        model = navgym.CoordinatedTurnModel()
        walk = navgym.Recording(np.arange(9.0), np.ones((9, model.m)), model=model)
        said = self.said(capsys, walk.save(tmp_path / "turn.npz"))
        assert said["model"].startswith("CoordinatedTurnModel of 5 states")
        assert "--filter ekf" in said["next"]

    def test_a_deck_says_its_lever_arm_and_what_was_taken_for_granted(self, capsys, ship, tmp_path):
        path = write_deck_csv(ship, tmp_path / "ship.csv")
        assert command.main(["read", str(path), "--read", "lever_arm", "1,2,3"]) == 0
        out = capsys.readouterr().out
        assert "lever arm 1, 2, 3 m; 100 samples/s, 20 filter steps/s" in out
        assert "IDAM section 5" in out

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (("absent.csv",), "no log at absent.csv"),
            (("{log}", "--read", "delimiter"), "'delimiter' stands alone"),
            (("{log}", "--format", "cvs"), "unknown format 'cvs'. Did you mean 'csv'"),
            (("{log}", "--format", "npz"), "mine.csv is not a navgym recording"),
        ],
    )
    def test_what_cannot_be_is_one_line_and_status_2(self, capsys, log, words, message):
        assert command.main(["read", *(w.format(log=log) for w in words)]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert message in err

    def test_every_argument_of_the_deck_reader_stands_in_its_manual(self):
        for option in options_of(read_deck_csv):
            assert f"        {option}: " in read_deck_csv.__doc__
