"""A portable policy computes what its learner computes, and refuses what it is not for."""

import dataclasses
import itertools
import json
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import navgym
from navgym import agents
from navgym.agents.live import command as stream
from navgym.agents.policies.manifest import Manifest
from navgym.agents.policies.policy import Normalisation, Policy, located
from navgym.auv.engine import Engine
from navgym.auv.settings import AUVDropoutSettings
from navgym.envs.columns import INFORMATION
from tests.agents.hand_made import forged
from tests.agents.hand_made import policy as hand_made

AUV, DECK = "navgym/AUVDropout-v0", "navgym/DeckDeformation-v0"
ACTIONS = ("process_noise_scale", "forgetting", "vb_iterations")


def engine_of(lanes=1, **arguments):
    chosen = {"overrides": {"steps": 30}, "action_parameters": ACTIONS, "action": "residual"}
    return Engine(AUVDropoutSettings(**chosen | arguments), lanes)


def layers(sizes, rng, scale=1.0):
    pairs = itertools.pairwise(sizes)
    return [(scale * rng.normal(size=(o, i)), rng.normal(size=o)) for i, o in pairs]


def some_policy(seed=0, sizes=(8, 6), engine=None, **options):
    rng = np.random.default_rng(seed)
    engine = engine or engine_of()
    manifest = Manifest.of(AUV, engine, {"command": "none", "seeds": [1, 2]})
    n, k = len(engine.observation_names), len(engine.table)
    normalisation = Normalisation(rng.normal(size=n), rng.uniform(0.1, 2.0, n), 3.0)
    own = layers((n, *sizes, k), rng, 0.3)
    return Policy(manifest, own, normalisation, -np.ones(n), np.ones(n), **options)


def observations(count, n, seed=1):
    return np.random.default_rng(seed).uniform(-5, 5, (count, n)).astype(np.float32)


class TestWhatItComputes:
    @pytest.mark.parametrize("activation", ["tanh", "relu"])
    @pytest.mark.parametrize("squash", [False, True])
    def test_it_is_the_network_as_the_text_books_write_it(self, activation, squash):
        policy = some_policy(activation=activation, squash=squash)
        o = observations(50, len(policy.low)).astype(np.float64)
        norm = policy.normalisation
        x = np.clip((o - norm.mean) / np.sqrt(norm.variance + norm.epsilon), -3.0, 3.0)
        for i, (w, b) in enumerate(policy.layers):
            x = x @ w.T.astype(np.float64) + b
            if i < len(policy.layers) - 1:
                x = np.tanh(x) if activation == "tanh" else np.maximum(x, 0.0)
        wanted = np.tanh(x) if squash else np.clip(x, -1.0, 1.0)
        np.testing.assert_allclose(policy(o.astype(np.float32)), wanted, atol=2e-6)
        assert (np.abs(wanted) < 1.0).any()

    def test_one_observation_or_many(self):
        policy = some_policy()
        many = observations(20, len(policy.low))
        single = np.array([policy(o) for o in many])
        np.testing.assert_allclose(single, policy(many), atol=1e-6)
        rows = np.array([policy.parameters(o) for o in many])
        np.testing.assert_allclose(rows, policy.parameters(many), rtol=1e-5)
        assert policy(many).shape == (20, 3)
        assert policy.parameters(many).shape == (20, 8)

    def test_the_observation_is_left_alone(self):
        policy = some_policy()
        given = observations(3, len(policy.low))
        kept = given.copy()
        policy.parameters(given)
        np.testing.assert_array_equal(given, kept)

    @pytest.mark.parametrize("action", ["residual", "absolute"])
    def test_parameters_are_what_the_environment_puts_in_force(self, action):
        engine = engine_of(4, action=action)
        for i in range(4):
            engine.seed(i, np.random.default_rng(i))
        seen = np.stack([engine.restart(i) for i in range(4)])
        met = []
        for seed in range(6):
            policy = some_policy(seed, engine=engine)
            rows = policy.parameters(seen)
            met.append(rows)
            out = engine.step(policy(seen), seen)
            inside = out[:, INFORMATION + len(engine.INFO_NAMES) :]
            np.testing.assert_array_equal(rows, inside)
        every = np.concatenate(met)
        np.testing.assert_array_equal(every[:, 0], every[:, 0].round())  # sweeps are whole
        varied = [len(np.unique(column)) > 1 for column in every.T]
        assert sum(varied) == len(ACTIONS)

    def test_no_number_is_refused_where_parameters_are_asked_for(self):
        policy = some_policy()
        with pytest.raises(ValueError, match="must be finite"):
            policy.parameters(np.full(len(policy.low), np.nan))

    @pytest.mark.parametrize("shape", [(3,), (2, 2, 44), ()])
    def test_a_wrong_shape_is_named(self, shape):
        with pytest.raises(ValueError, match="observation must have shape"):
            some_policy()(np.zeros(shape))


def sb3():
    return pytest.importorskip("stable_baselines3")


class TestFromStableBaselines3:
    @pytest.mark.parametrize("name", ["PPO", "SAC", "TD3"])
    @pytest.mark.parametrize("normalised", [True, False])
    def test_it_equals_the_deterministic_prediction(self, name, normalised):
        package = sb3()
        from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

        def make():
            return gymnasium.make(AUV, overrides={"steps": 30}, pool=2, action="residual")

        env = DummyVecEnv([make])
        if normalised:
            env = VecNormalize(env, clip_obs=4.0)
        options = (
            {"n_steps": 32, "batch_size": 32}
            if name == "PPO"
            else {"learning_starts": 8, "buffer_size": 100}
        )
        model = getattr(package, name)("MlpPolicy", env, device="cpu", seed=0, **options)
        model.learn(32)
        engine = env.envs[0].unwrapped.engine
        policy = Policy.from_sb3(model, env if normalised else None, Manifest.of(AUV, engine, {}))
        o = observations(200, len(policy.low))
        given = env.normalize_obs(o) if normalised else o
        wanted = model.predict(given, deterministic=True)[0]
        np.testing.assert_allclose(policy(o), wanted, atol=1e-6)
        assert np.ptp(wanted) > 1e-3

    def test_layers_of_another_kind_are_refused(self):
        package = sb3()
        from torch import nn

        env = gymnasium.make(AUV, overrides={"steps": 30}, pool=1)
        kwargs = {"activation_fn": nn.ELU}
        model = package.PPO("MlpPolicy", env, device="cpu", policy_kwargs=kwargs, n_steps=64)
        with pytest.raises(ValueError, match="dense layers with tanh or relu, got ELU"):
            Policy.from_sb3(model, None, Manifest.of(AUV, env.unwrapped.engine, {}))


class TestFiles:
    @pytest.fixture
    def saved(self, tmp_path):
        some_policy().save(tmp_path / "p")
        return tmp_path / "p.npz"

    @pytest.mark.parametrize("name", ["p", "p.npz", "p.json"])
    def test_what_is_saved_is_loaded(self, tmp_path, name):
        policy = some_policy(activation="relu", squash=True)
        assert policy.save(tmp_path / name) == tmp_path / "p.npz"
        again = Policy.load(tmp_path / name)
        o = observations(5, len(policy.low))
        np.testing.assert_array_equal(again(o), policy(o))
        np.testing.assert_array_equal(again.parameters(o), policy.parameters(o))
        assert again.manifest == policy.manifest
        np.testing.assert_array_equal(again.high, policy.high)

    def test_saving_twice_gives_the_same_bytes(self, saved, tmp_path):
        some_policy().save(tmp_path / "q")
        assert (tmp_path / "q.json").read_bytes() == (tmp_path / "p.json").read_bytes()

    def test_a_dot_in_the_name_is_kept(self, tmp_path):
        assert some_policy().save(tmp_path / "v1.2").name == "v1.2.npz"
        assert Policy.load(tmp_path / "v1.2").manifest == some_policy().manifest

    def test_torch_is_not_needed(self, saved):
        code = (
            "import sys, numpy as np\nfrom agents import Policy\n"
            f"p = Policy.load({str(saved)!r})\np.parameters(np.zeros(len(p.low)))\n"
            "assert not {'torch', 'stable_baselines3', 'optuna', 'matplotlib'} & set(sys.modules)"
        )
        subprocess.run([sys.executable, "-c", code], check=True)

    @pytest.mark.parametrize("missing", [".npz", ".json"])
    def test_a_missing_half_is_named(self, saved, missing):
        saved.with_suffix(missing).unlink()
        with pytest.raises(FileNotFoundError, match=rf"p\{missing} is missing.*copy both"):
            Policy.load(saved)

    @pytest.mark.parametrize("suffix", [".npz", ".json"])
    @pytest.mark.parametrize("length", [0, 10, 200])
    def test_a_truncated_half_is_named(self, saved, suffix, length):
        path = saved.with_suffix(suffix)
        path.write_bytes(path.read_bytes()[:length])
        with pytest.raises(ValueError, match=rf"p\{suffix} .*truncated"):
            Policy.load(saved)

    def test_a_foreign_file_is_refused(self, saved):
        navgym.simulate("auv/nominal", steps=5).save(saved)
        with pytest.raises(ValueError, match="does not belong"):
            Policy.load(saved)
        saved.with_suffix(".json").write_text('{"name": "something else"}')
        with pytest.raises(ValueError, match="does not describe a navgym policy"):
            Policy.load(saved)

    def test_pickled_content_is_not_touched(self, saved):
        class Trap:
            def __reduce__(self):
                return pytest.fail, ("unpickled",)

        np.savez(saved, low=np.array([Trap()], dtype=object))
        with pytest.raises(ValueError, match="no navgym policy"):
            Policy.load(saved)

    def test_halves_of_two_policies_do_not_mix(self, saved, tmp_path):
        some_policy(seed=1).save(tmp_path / "q")
        (tmp_path / "q.npz").replace(saved)
        with pytest.raises(ValueError, match="does not belong"):
            Policy.load(saved)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"format": 99}, "format 99"),
            ({"kind": "recipe"}, "describes a recipe"),
            ({"space": "0123"}, "parameter space 0123 of qivbf"),
            ({"filter": "qivbff"}, "unknown filter"),
            ({"observation_names": ["a", "b"]}, r"must have shape \(2,\)"),
            ({"reference": {"forgetting": 3.0}}, "forgetting must lie in"),
            ({"architecture": {}}, "sizes"),
        ],
    )
    def test_an_edited_manifest_is_refused(self, saved, change, message):
        forged(saved, json.loads(saved.with_suffix(".json").read_text()) | change)
        with pytest.raises(ValueError, match=message):
            Policy.load(saved)

    @pytest.mark.parametrize("name", ["scenario", "action_parameters"])
    def test_a_manifest_without_a_setting_that_matters_is_refused(self, saved, name):
        facts = json.loads(saved.with_suffix(".json").read_text())
        del facts["settings"][name]
        forged(saved, facts)
        with pytest.raises(ValueError, match=f"settings lack '{name}'"):
            Policy.load(saved)

    def test_a_policy_that_sets_what_the_filter_lacks_is_refused(self, saved):
        facts = json.loads(saved.with_suffix(".json").read_text())
        facts["settings"]["action_parameters"][0] = "forgeting"
        forged(saved, facts)
        with pytest.raises(ValueError, match="Did you mean 'forgetting'"):
            Policy.load(saved)

    def test_a_manifest_that_lacks_something_is_refused(self, saved):
        path = saved.with_suffix(".json")
        facts = json.loads(path.read_text())
        del facts["reference"]
        path.write_text(json.dumps(facts))
        with pytest.raises(ValueError, match="lacks 'reference'"):
            Policy.load(saved)

    def test_a_failed_write_leaves_the_old_policy(self, saved, tmp_path, monkeypatch):
        def fail(*_, **__):
            raise OSError("disk full")

        monkeypatch.setattr(np, "savez_compressed", fail)
        with pytest.raises(OSError, match="disk full"):
            some_policy(seed=1).save(saved)
        monkeypatch.undo()
        assert Policy.load(saved).manifest == some_policy().manifest
        assert sorted(f.name for f in tmp_path.iterdir()) == ["p.json", "p.npz"]


class TestWhatCannotBe:
    def rebuilt(self, **changes):
        policy = some_policy()
        own = {
            "layers": policy.layers, "normalisation": policy.normalisation, "low": policy.low,
            "high": policy.high,
        }  # fmt: skip
        return Policy(policy.manifest, **own | changes)

    def test_weights_that_are_no_numbers(self):
        bad = [(w.copy(), b) for w, b in some_policy().layers]
        bad[1][0][2, 3] = np.nan
        with pytest.raises(
            ValueError, match=r"weights\.1 must be finite, got nan at index \(2, 3\)"
        ):
            self.rebuilt(layers=bad)

    def test_shapes_that_do_not_fit(self):
        own = some_policy().layers
        with pytest.raises(ValueError, match=r"weights\.1 must have shape \(6, 8\)"):
            self.rebuilt(layers=[own[0], (own[1][0][:, :5], own[1][1]), own[2]])
        with pytest.raises(ValueError, match=r"weights\.1 must have shape \(3, 8\)"):
            self.rebuilt(layers=own[:2])
        with pytest.raises(ValueError, match="at least one pair"):
            self.rebuilt(layers=[])
        with pytest.raises(ValueError, match="low must have shape"):
            self.rebuilt(low=np.zeros(3))

    def test_a_normalisation_that_divides_by_nothing(self):
        own = some_policy().normalisation
        with pytest.raises(ValueError, match="variance must not be negative"):
            self.rebuilt(normalisation=dataclasses.replace(own, variance=-own.variance))
        with pytest.raises(ValueError, match="clip must be positive"):
            self.rebuilt(normalisation=dataclasses.replace(own, clip=0.0))
        for name in ("mean", "variance"):  # one number would be spread over all observations
            with pytest.raises(ValueError, match=f"{name} must have shape"):
                self.rebuilt(normalisation=dataclasses.replace(own, **{name: np.ones(1)}))

    def test_an_unknown_activation(self):
        with pytest.raises(ValueError, match=r"unknown activation 'tan'\. Did you mean 'tanh'"):
            self.rebuilt(activation="tan")


class TestWhatItIsFor:
    def test_its_own_environment_passes(self):
        engine = engine_of()
        some_policy().check(AUV, engine.observation_names, engine.space.fingerprint)
        again = gymnasium.make(AUV, **some_policy().manifest.settings).unwrapped.engine
        some_policy().check(AUV, again.observation_names, again.space.fingerprint)

    @pytest.mark.parametrize("other", [DECK, "navgym/AUVDropout-v1"])
    def test_another_environment_is_refused_naming_both(self, other):
        engine = engine_of()
        with pytest.raises(ValueError, match=f"trained in {AUV}, not in {other}"):
            some_policy().check(other, engine.observation_names, engine.space.fingerprint)

    def test_another_parameter_space_is_refused_naming_both(self):
        engine = engine_of()
        own = engine.space.fingerprint
        with pytest.raises(ValueError, match=f"space {own}, and .* has space beef"):
            some_policy().check(AUV, engine.observation_names, "beef")

    def test_other_observations_are_refused_naming_the_difference(self):
        engine = engine_of(action_parameters=(*ACTIONS[:2], "prior_count"))
        with pytest.raises(ValueError, match=r"parameter\.vb_iterations, parameter\.prior_count"):
            some_policy().check(AUV, engine.observation_names, engine.space.fingerprint)

    def test_the_manifest_says_what_the_environment_was(self):
        engine = engine_of(scenario=("auv/switch-D", "auv/switch-B"), decision_interval=3)
        manifest = Manifest.of(AUV, engine, {})
        assert manifest.settings["scenario"] == ["auv/switch-D", "auv/switch-B"]
        assert manifest.settings["decision_interval"] == 3
        assert manifest.settings["overrides"] == {"steps": 30}
        assert manifest.reference == engine.reference
        assert manifest.filter == "qivbf"
        made = gymnasium.make(AUV, **manifest.settings).unwrapped.engine
        assert made.reference == engine.reference

    def test_a_scenario_object_is_written_by_name(self):
        scenario = navgym.simulation.find_scenario("auv/heavy", steps=20)
        assert Manifest.of(AUV, engine_of(scenario=scenario), {}).settings["scenario"] == [
            "auv/heavy"
        ]

    def test_what_json_cannot_hold_is_refused(self):
        with pytest.raises(ValueError, match="JSON"):
            Manifest.of(AUV, engine_of(), {"model": object()})


def test_names_of_the_package_load_on_first_use():
    assert agents.Policy is Policy
    assert "Policy" in dir(agents)
    with pytest.raises(AttributeError, match="no attribute 'Police'"):
        agents.Police  # noqa: B018


@pytest.mark.parametrize(
    ("name", "environment"), [("auv", AUV), ("deck", "navgym/DeckDeformation-v0")]
)
def test_a_shipped_policy_fits_todays_environment(name, environment):
    policy = agents.shipped(name)
    assert policy.manifest.environment == environment
    engine = gymnasium.make_vec(
        environment, num_envs=1,
        **{k: v for k, v in policy.manifest.settings.items() if k not in ("scenario", "overrides")},
    ).unwrapped.engine  # fmt: skip
    policy.check(environment, engine.observation_names, engine.space.fingerprint)
    assert policy.manifest.training["command"].startswith(
        ("python scripts/train.py", "navgym train")
    )


def test_an_unknown_shipped_policy_is_refused():
    with pytest.raises(ValueError, match="Did you mean 'auv'"):
        agents.shipped("auvv")


def test_a_problem_that_no_policy_is_shipped_for_is_told_so():
    """None that was trained on ins is better than the best fixed hold: docs/agents.md."""
    for ask in (located, lambda name: stream.main([name])):
        with pytest.raises(
            FileNotFoundError, match=r"no policy for 'ins', only for auv, deck: train"
        ):
            ask("ins")
    with pytest.raises(ValueError, match="no policy for 'ins'"):
        agents.shipped("ins")


class TestAnotherReference:
    def test_actions_start_from_the_reference_that_it_is_put_around(self, tmp_path):
        policy = agents.shipped("auv")
        path = tmp_path / "tuned.toml"
        path.write_text(
            'filter = "qivbf"\n[parameters]\nprocess_noise_scale = 3.0\nforgetting = 0.95\n'
        )
        own = policy.with_reference(path).silent()
        row = own.parameters(np.zeros(len(own.low)))
        space = own.manifest.whole_space
        assert row[space.index("process_noise_scale")] == pytest.approx(3.0)
        assert row[space.index("forgetting")] == pytest.approx(0.95)
        assert own.manifest.training["reference_since"] == "tuned.toml"
        kept = Policy.load(own.save(tmp_path / "own"))
        assert kept.manifest.reference == own.manifest.reference
        live = agents.SelfTuningFilter("qivbf", kept, navgym.LinearModel())
        found = live.step(np.zeros(4))
        assert found.parameters["forgetting"] == pytest.approx(0.95)

    def test_parameters_of_another_filter_and_absolute_policies_are_refused(self, tmp_path):
        path = tmp_path / "tuned.toml"
        path.write_text('filter = "kf"\n[parameters]\nprocess_noise_scale = 3.0\n')
        with pytest.raises(ValueError, match="filter of the reference"):
            agents.shipped("auv").with_reference(path)
        with pytest.raises(ValueError, match="forgettin"):
            agents.shipped("auv").with_reference({"forgettin": 0.9})
        absolute = hand_made("navgym/AUVDropout-v0", "auv/switch-D", action="absolute")
        with pytest.raises(ValueError, match="outright"):
            absolute.with_reference({"forgetting": 0.9})

    def test_a_policy_that_reads_the_true_regime_is_refused_at_sea(self):
        seer = hand_made("navgym/AUVDropout-v0", "auv/switch-D", context="regime")
        assert seer.manifest.observation_names[-1] == "regime.2"
        with pytest.raises(ValueError, match="nobody knows at sea"):
            agents.SelfTuningFilter("qivbf", seer, navgym.LinearModel())
