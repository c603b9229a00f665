"""`navgym/AUVDropout-v0`: tune QIVBF while an AUV loses measurements. Single and batch face."""

from __future__ import annotations

from navgym.auv.engine import Engine
from navgym.auv.settings import AUVDropoutSettings
from navgym.envs.faces import LaneEnv, LaneVectorEnv
from navgym.problem import lazy


class AUVDropoutEnv(LaneEnv):
    """Choose the parameters of a variational-Bayes navigation filter while it runs.

    ## Description
    An AUV moves with nearly constant velocity; its position and velocity are measured, some
    measurements get lost, and the noise of measurements and motion changes between regimes that
    nobody announces. QIVBF (Yang et al. 2020, corrected) estimates the track. The agent sets the
    filter's parameters every `decision_interval` samples, from what the filter itself knows. The
    parameters never change the truth or the measurements.

    | fact | value |
    |---|---|
    | task | dynamic algorithm configuration of a filter, one recording per episode |
    | cost | squared position error against a filter with fixed parameters on the same recording |
    | parameters | any of `navgym.parameter_space("qivbf")` that act while it runs |
    | state information | statistics of innovations and of the filter; never the truth |
    | noise level | high: the error of one decision is dominated by measurement noise |
    | instances | recordings of a scenario, split into train, validation and test by seed |

    ## Action Space
    `Box(-1, 1, (k,), float32)`, an element per name in `action_parameters`. With
    `action="absolute"`, -1 and 1 are the ends of the parameter's range and the way between is
    linear in its own scale; with `action="residual"`, 0 is the reference parameter and 1 is half
    the range away. Values outside are clipped; whole-number parameters are rounded.

    {parameters}

    ## Observation Space
    `Box(-5, 5, (41 + k,), float32)`. Each signal is followed by exponential means that keep .5, .8
    and .95 per received sample; logarithms are half natural logarithms of mean squares, so 0 is
    "as the model says".

    | index | name | unit | range | meaning |
    |---|---|---|---|---|
    | 0-2 | filter.log_nis | 1 | -5 to 5 | NIS of the controlled filter per received component |
    | 3-5 | filter.alarm | 1 | 0 to 1 | share of samples with NIS above 5 per component |
    | 6-8 | filter.correlation | 1 | -1 to 1 | cosine between successive innovations |
    | 9-11 | filter.power_position | 1 | -5 to 5 | innovation power of positions over R |
    | 12-14 | filter.power_velocity | 1 | -5 to 5 | innovation power of velocities over R |
    | 15-29 | frozen.* | | | the same of a Kalman filter with the model's Q and R, run beside |
    | 30-32 | curvature | 1 | -5 to 5 | miss of the parabola through the last three samples: tells R from Q |
    | 33-35 | lost | 1 | 0 to 1 | share of lost components |
    | 36 | since_received | 1 | 0 to 5 | half log of 1 + samples since anything was received |
    | 37, 38 | noise_position, noise_velocity | 1 | -5 to 5 | estimated R over the model's R |
    | 39 | widening | 1 | -5 to 5 | adapted over predicted covariance |
    | 40 | change | 1 | -5 to 5 | how far the last sweep still moved the state |
    | 41- | parameter.* | 1 | -1 to 1 | parameters in force, in their range |

    ## Rewards
    `reward="difference"` (default): minus the mean over the decision of the squared position error
    less that of the reference filter on the same recording, m², clipped to plus or minus
    `reward_clip`. `"over-oracle"`: minus the squared error over the variance of a filter that knows
    the true noise. `"relative"`: the difference over the mean variance of that filter on the recording,
    so that recordings of any noise count alike. `"absolute"`: minus the root of the mean squared error, m. `"likelihood"`: mean
    log-likelihood of the innovations, for recordings without truth.

    ## Starting State
    The filter holds x0, P0 one sample before the first measurement; the observation is zero but
    for the parameters in force, which are the reference's. `reset(options={{"start": k}})` filters
    k samples with them beforehand, and `options={{"recording": i}}` chooses a recording of the pool.

    ## Episode End
    `terminated` if the filter diverges (a covariance loses definiteness, or for some twenty samples
    it foretells worse than who repeats the last measurement): the reward is then -`reward_clip`. `truncated` at the recording's end.

    ## Information
    `rmse` and `reference_rmse` of the decision (m), `nis` per received component, `lost` samples,
    `regime` (for analysis only: a policy must not see it), `reward_term` before clipping, and every
    parameter of the filter in physical units. `reset` returns what the recording is.

    ## Arguments
    {arguments}

    ```python
    >>> import gymnasium, navgym
    >>> env = gymnasium.make("navgym/AUVDropout-v0", scenario="auv/switch-D")
    >>> obs, info = env.reset(seed=1)
    >>> obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    >>> obs.shape, terminated
    ((45,), False)

    ```

    ## Version History
    * v0: first version
    """

    SETTINGS = AUVDropoutSettings
    ENGINE = Engine
    PAINTER = lazy("navgym.auv.painter:Painter")


class AUVDropoutVectorEnv(LaneVectorEnv):
    """The batch face of `AUVDropoutEnv`; see `LaneVectorEnv`.

    Args:
        num_envs: number of lanes.
        max_episode_steps: truncate episodes after this many decisions, or None.
        arguments: those of `AUVDropoutEnv`.
    """

    SETTINGS = AUVDropoutSettings
    ENGINE = Engine
    PAINTER = lazy("navgym.auv.painter:Painter")
