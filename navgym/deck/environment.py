"""`navgym/DeckDeformation-v0`: tune the robust deck filter while the sea changes. Single and batch face."""

from __future__ import annotations

from navgym.deck.engine import DeckEngine
from navgym.deck.settings import DeckDeformationSettings
from navgym.envs.faces import LaneEnv, LaneVectorEnv
from navgym.problem import lazy


class DeckDeformationEnv(LaneEnv):
    """Choose the robustness of a deck attitude filter while it runs.

    ## Description
    A ship's deck bends between a main and a sub IMU. A 24-state filter (Zhao et al. 2024, corrected)
    estimates the sub IMU's attitude, the static and the dynamic deformation θ from the differences
    of both IMUs' rates and velocities. Some of these are wrong (glitches), and an innovation is large
    as well where a wave slams the deck, which the gyros see correctly. One kernel width of
    the correntropy criterion cannot serve both: a narrow kernel rejects glitches and slams alike. The
    agent sets the filter's parameters each second, from what the filter itself knows. They never
    change the truth or the measurements.

    | fact | value |
    |---|---|
    | task | dynamic algorithm configuration of a filter, one recording per episode |
    | cost | squared errors of θ̇ and of the fast part of θ against a filter with fixed parameters on the same recording |
    | parameters | `kernel_width` and `velocity_noise`; any of `navgym.parameter_space("idam")` that act while it runs |
    | state information | statistics of innovations and weights; never the truth |
    | noise level | high within a second, low over a segment of a minute |
    | instances | recordings of a scenario, split into train, validation and test by seed |

    ## Action Space
    `Box(-1, 1, (k,), float32)`, an element per name in `action_parameters`. With
    `action="absolute"`, -1 and 1 are the ends of the parameter's range and the way between is
    linear in its own scale (a kernel of width 50 is off); with `action="residual"`, 0 is the
    reference parameter and 1 is half the range away. Values outside are clipped.

    {parameters}

    With `rvm_kernel_scale` among the action's parameters, each lane identifies the flexure anew
    after every `identification_window` (of the reference, 120 s by default) that ends after the warm-up.

    ## Observation Space
    `Box(-5, 5, (14 + k,), float32)`, or `(8 + k,)` with `features="gyro"`, which drops the first six.
    Exponential means that keep .8, .97 and .995 per filter step; logarithms are half natural
    logarithms of mean squares, so 0 is "as the filter expects".

    | index | name | unit | range | meaning |
    |---|---|---|---|---|
    | 0-2 | velocity.log_nis | 1 | -4.6 to 5 | innovation power over its variance S, velocity channels |
    | 3 | velocity.alarm | 1 | 0 to 1 | share of innovations beyond 4 standard deviations |
    | 4 | velocity.persistence | 1 | -1 to 1 | the next innovation over one that was beyond: negative if a glitch passed, positive if a slam was rejected |
    | 5 | velocity.rejected | 1 | 0 to 1 | one less the mean weight of the kernel |
    | 6-11 | rate.* | | | the same of the rate channels |
    | 12, 13 | sea.10s, sea.60s | 1 | -1.5 to 5 | θ̇ over what the believed flexure model expects |
    | 14- | parameter.* | 1 | -1 to 1 | parameters in force, in their range |

    ## Rewards
    `reward="composite"` (default): minus the sum of three terms, clipped to plus or minus
    `reward_clip`. Each compares the filter with the reference on the same recording: its mean squared
    error over the decision less the reference's, over the reference's mean over the recording. The first
    is θ̇; the second, times `ac_weight`, is θ, its error less the error's running mean over 60 s (what gyros can see; causal here, where
    `navgym.deck.errors` centres it);
    the third, times `theta_price`, is θ itself, and counts only where it is worse than the reference's,
    so that θ is not traded away. `"absolute"`: minus the RMS of θ̇'s error, arcmin/s. `"likelihood"`:
    mean log-likelihood of the innovations less the reference's, for recordings without truth.

    ## Starting State
    The reference filter runs for `warmup` seconds first: before, the filter is still finding its
    alignment, whatever its parameters. `reset(options={{"start": k}})` takes k filter steps instead, and
    `options={{"recording": i}}` chooses a recording of the pool.

    ## Episode End
    `terminated` if the filter diverges (a covariance loses definiteness, or innovations run away a
    hundred times beyond S): the reward is then -`reward_clip`. `truncated` at the recording's end.

    ## Information
    RMS errors of the decision and of the reference on it, `theta_rate_rmse` (arcmin/s),
    `theta_ac_rmse`, `theta_rmse` (arcmin), `reference_*`; `weight` (mean kernel weight), `power` (mean
    squared innovation over S), `regime` (for analysis only: a policy must not see it), `reward_term`
    before clipping, and every parameter in physical units. `reset` returns what the recording is.

    ## Arguments
    {arguments}

    ```python
    >>> import gymnasium, navgym
    >>> env = gymnasium.make("navgym/DeckDeformation-v0", overrides={{"duration": 90.0}})
    >>> obs, info = env.reset(seed=1)
    >>> obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    >>> obs.shape, terminated
    ((16,), False)

    ```

    ## Version History
    * v0: first version
    """

    SETTINGS = DeckDeformationSettings
    ENGINE = DeckEngine
    PAINTER = lazy("navgym.deck.painter:DeckPainter")


class DeckDeformationVectorEnv(LaneVectorEnv):
    """The batch face of `DeckDeformationEnv`; see `LaneVectorEnv`.

    Args:
        num_envs: number of lanes.
        max_episode_steps: truncate episodes after this many decisions, or None.
        arguments: those of `DeckDeformationEnv`.
    """

    SETTINGS = DeckDeformationSettings
    ENGINE = DeckEngine
    PAINTER = lazy("navgym.deck.painter:DeckPainter")
