"""A checkpoint is whole or it is passed over, and never unpickled."""

import os

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")
pytest.importorskip("tomli_w")

from navgym.agents.training import checkpoints
from navgym.agents.training.checkpoints import Checkpoint


class TestCheckpoints:
    @pytest.fixture
    def folder(self, tmp_path):
        for decisions in (100, 200, 300):
            arrays = {"x": np.arange(decisions)}
            checkpoints.save(tmp_path, decisions, Checkpoint(arrays, {"n": decisions}))
        return tmp_path

    def test_the_last_two_are_kept(self, folder):
        assert [p.name for p in sorted(folder.iterdir())] == [
            "000000000200.npz",
            "000000000300.npz",
        ]
        found, problems = checkpoints.latest(folder)
        assert (found.facts["n"], len(found.arrays["x"]), problems) == (300, 300, [])

    @pytest.mark.parametrize("length", [0, 50, 2000, -30])
    def test_a_half_written_one_is_passed_over(self, folder, length):
        path = folder / "000000000300.npz"
        path.write_bytes(path.read_bytes()[:length])
        found, problems = checkpoints.latest(folder)
        assert found.facts["n"] == 200
        assert "000000000300.npz is damaged" in problems[0]

    def test_a_changed_one_is_passed_over(self, folder):
        path = folder / "000000000300.npz"
        with np.load(path) as file:
            arrays = dict(file)
        np.savez(path, **arrays | {"x": arrays["x"] + 1})
        found, problems = checkpoints.latest(folder)
        assert found.facts["n"] == 200
        assert "hash" in problems[0]

    def test_nothing_is_unpickled(self, folder):
        class Trap:
            def __reduce__(self):
                return pytest.fail, ("unpickled",)

        np.savez(folder / "000000000400.npz", x=np.array([Trap()], dtype=object))
        found, problems = checkpoints.latest(folder)
        assert found.facts["n"] == 300
        assert len(problems) == 1

    @pytest.mark.parametrize("facts", [[1], 3, None, "text"])
    def test_one_without_facts_is_passed_over(self, folder, facts):
        checkpoints.save(folder, 400, Checkpoint({"x": np.arange(3)}, facts))
        found, problems = checkpoints.latest(folder)
        assert found.facts["n"] == 300
        assert "lacks its facts" in problems[0]

    @pytest.mark.parametrize("facts", [{}, {"configuration": 3}, {"configuration": [[1]]}])
    def test_one_whose_facts_were_forged_is_refused_and_names_the_remedy(self, tmp_path, facts):
        checkpoints.save(tmp_path / "checkpoints", 400, Checkpoint({"x": np.arange(3)}, facts))
        with pytest.raises(
            ValueError, match=r"another navgym or is forged .*: start anew \(--fresh"
        ):
            checkpoints.to_continue(tmp_path, {"seed": 1}, pytest.fail)

    def test_networks_that_were_forged_run_nobodys_code(self, tmp_path):
        trace = tmp_path / "foreign code ran"

        class Trap:
            def __reduce__(self):
                return os.mkdir, (str(trace),)

        forged = {"networks": checkpoints.packed({"parts": Trap()})}
        checkpoints.save(tmp_path / "checkpoints", 400, Checkpoint(forged, {"configuration": {}}))
        kept = checkpoints.to_continue(tmp_path, {}, pytest.fail)
        with pytest.raises(ValueError, match="is forged"), checkpoints.fitting(tmp_path):
            checkpoints.unpacked(kept.arrays["networks"])
        assert not trace.exists()

    def test_none_is_none(self, tmp_path):
        assert checkpoints.latest(tmp_path / "absent") == (None, [])
